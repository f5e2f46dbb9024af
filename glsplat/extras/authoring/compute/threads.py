"""Run work on several threads, and keep BLAS on one."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, Generic, Self, TypeVar, overload

import numpy as np
import scipy

from glsplat.io.cores import cores

_OPENBLAS_NAMES = "scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads"

# Options of malloc.h: M_ARENA_MAX, M_MMAP_THRESHOLD (32 MiB is the largest allowed) and M_TRIM_THRESHOLD, in bytes.
_MALLOC_OPTIONS = {-8: max(cores(), 2), -3: 32 << 20, -1: 256 << 20}

_lock = Lock()
_users: list[None] = []  # one entry for each open one_blas_thread()
_previous: list[tuple[Callable[[int], Any], int]] = []  # setters and the thread counts to restore

T = TypeVar("T")
U = TypeVar("U")
Owner = TypeVar("Owner")


def map_threads(work: Callable[[T], U], pieces: Iterable[T]) -> list[U]:
    """Return the results of ``work`` for all ``pieces``, in order, computed on one thread a core.

    Suits numpy and OpenCV on large arrays, which release the GIL. Raises what ``work`` raises.

    >>> from glsplat.extras.authoring.compute.threads import map_threads
    >>> map_threads(lambda n: n * n, [1, 2, 3])
    [1, 4, 9]
    """
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(work, pieces))


def run_in_background(work: Callable[[], T]) -> Callable[[], T]:
    """Start ``work`` on another thread and return a function that waits for its result or raises its error.

    An error is lost if that function is never called. The process does not end before ``work`` has.

    >>> from glsplat.extras.authoring.compute.threads import run_in_background
    >>> result = run_in_background(lambda: 6 * 7)
    >>> result()
    42
    """
    pool = ThreadPoolExecutor(1, "glsplat-background")
    future = pool.submit(work)
    pool.shutdown(wait=False)
    return future.result


def share_heap() -> None:
    """Make this process have one glibc heap a core, which keeps freed memory; other C libraries are unchanged.

    More take a quarter more memory for an avatar, because each keeps what its arrays have freed; with one for all, the
    threads of a k-d tree wait for each other. Keeping freed arrays of up to 32 MiB saves the kernel from clearing their
    pages again.
    """
    with suppress(AttributeError, OSError, TypeError):  # other C libraries, and Windows
        library = ctypes.CDLL(None)
        for option, value in _MALLOC_OPTIONS.items():
            library.mallopt(option, value)


class locked_cached_property(Generic[Owner, T]):  # noqa: N801 - used as a decorator, as functools.cached_property is
    """Decorate a method as a property that one thread computes once while others wait.

    ``functools.cached_property`` has no lock since Python 3.12, so concurrent threads would each compute the value.
    """

    def __init__(self, compute: Callable[[Owner], T]) -> None:
        self._compute, self._name = compute, compute.__name__
        self.__doc__ = compute.__doc__

    @overload
    def __get__(self, owner: None, kind: type[Owner]) -> Self: ...

    @overload
    def __get__(self, owner: Owner, kind: type[Owner]) -> T: ...

    def __get__(self, owner: Owner | None, kind: type[Owner]) -> Self | T:
        if owner is None:
            return self
        values = vars(owner)
        with values.setdefault(f"{self._name}, lock", Lock()):
            if self._name not in values:
                values[self._name] = self._compute(owner)
        values.pop(f"{self._name}, lock", None)  # a lock cannot be copied
        value: T = values[self._name]
        return value


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit OpenBLAS to one thread in the whole process, so that results have the same bytes on any number of cores.

    With more threads OpenBLAS adds in another order, and its idle threads spin between products, which takes half of
    the time of a busy machine. Works for numpy and scipy from PyPI; other BLAS libraries are left alone.
    """
    with _lock:
        if not _previous:
            for get, put in _openblas():
                _previous.append((put, get()))
                put(1)
        _users.append(None)
    try:
        yield
    finally:
        with _lock:
            _users.pop()
            while not _users and _previous:
                put, count = _previous.pop()
                put(count)


@lru_cache(maxsize=1)
def _openblas() -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
    """Return (get, set) of the number of threads, for each copy of OpenBLAS that numpy and scipy bring along."""
    found = []
    for package in (np, scipy):
        folder = Path(str(package.__file__)).parent
        for path in (*folder.with_name(f"{folder.name}.libs").glob("*openblas*"), *folder.glob(".dylibs/*openblas*")):
            library = ctypes.CDLL(str(path))
            for name in _OPENBLAS_NAMES:
                if hasattr(library, name.format("set")):
                    found.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
                    break
    return found
