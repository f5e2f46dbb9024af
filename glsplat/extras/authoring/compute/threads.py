"""Who works on how many cores: pieces of work beside each other, and products of matrices on one."""

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

__all__ = ["abreast", "aside", "found_once", "one_blas_thread", "one_heap"]

_NAMES = "scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads"

# Of malloc.h: all threads share a heap, which keeps arrays of up to 32 MiB, the most there may be, and what is freed of
# them; else every large array is memory that the kernel has to clear anew.
_MALLOC = {-8: 1, -3: 32 << 20, -1: 256 << 20}  # M_ARENA_MAX, M_MMAP_THRESHOLD, M_TRIM_THRESHOLD

_lock = Lock()
_inside: list[None] = []  # one of everybody who wants one thread
_before: list[tuple[Callable[[int], Any], int]] = []  # how many threads there were before the first of them

T = TypeVar("T")
U = TypeVar("U")
Owner = TypeVar("Owner")


def abreast(work: Callable[[T], U], pieces: Iterable[T]) -> list[U]:
    """``work`` of each piece, in their order, so that sums of them do not hang on the number of threads.

    For numpy and OpenCV on large arrays, which let other threads run meanwhile. Raises what ``work`` raises.

    >>> from glsplat.extras.authoring.compute.threads import abreast
    >>> abreast(lambda n: n * n, [1, 2, 3])
    [1, 4, 9]
    """
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(work, pieces))


def aside(work: Callable[[], T]) -> Callable[[], T]:
    """Begin ``work`` on another thread; what comes back waits for its result, or raises what it raised.

    Who drops what comes back drops the error with it, and the process does not end before ``work`` has.

    >>> from glsplat.extras.authoring.compute.threads import aside
    >>> found = aside(lambda: 6 * 7)
    >>> found()
    42
    """
    pool = ThreadPoolExecutor(1, "glsplat-aside")
    begun = pool.submit(work)
    pool.shutdown(wait=False)
    return begun.result


def one_heap() -> None:
    """From now on this process's threads share one heap of the C library, where that is glibc; else nothing happens.

    Each keeps what its arrays have freed: with a heap a thread an avatar took a fifth more memory. And the heap keeps
    it for the next array, which else cost a third of the time that the kernel takes.
    """
    with suppress(AttributeError, OSError, TypeError):  # other C libraries, and Windows
        library = ctypes.CDLL(None)
        for what, value in _MALLOC.items():
            library.mallopt(what, value)


class found_once(Generic[Owner, T]):  # noqa: N801 - used as a decorator, as functools.cached_property is
    """A property that is found at its first use and kept, by one thread while others wait for it.

    ``functools.cached_property`` has no lock since Python 3.12: threads that ask at the same time each find it.
    """

    def __init__(self, find: Callable[[Owner], T]) -> None:
        self._find, self._name = find, find.__name__
        self.__doc__ = find.__doc__

    @overload
    def __get__(self, owner: None, kind: type[Owner]) -> Self: ...

    @overload
    def __get__(self, owner: Owner, kind: type[Owner]) -> T: ...

    def __get__(self, owner: Owner | None, kind: type[Owner]) -> Self | T:
        if owner is None:
            return self
        kept = vars(owner)
        with kept.setdefault(f"{self._name}, lock", Lock()):
            if self._name not in kept:
                kept[self._name] = self._find(owner)
        kept.pop(f"{self._name}, lock", None)  # a lock cannot be copied
        found: T = kept[self._name]
        return found


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Meanwhile products of matrices take one core, in the whole process: the same bytes on any number of cores.

    OpenBLAS adds in another order with more threads, and these wait for the next product by running on: for many small
    ones that is half of the time of a machine that is busy. For numpy and scipy of PyPI; nothing where they have
    another library.
    """
    with _lock:
        if not _before:
            for get, put in _openblas():
                _before.append((put, get()))
                put(1)
        _inside.append(None)
    try:
        yield
    finally:
        with _lock:
            _inside.pop()
            while not _inside and _before:
                put, count = _before.pop()
                put(count)


@lru_cache(maxsize=1)
def _openblas() -> list[tuple[Callable[[], int], Callable[[int], Any]]]:
    """What asks and sets the number of threads of each copy of OpenBLAS that numpy and scipy brought along."""
    found = []
    for package in (np, scipy):
        folder = Path(str(package.__file__)).parent
        for path in (*folder.with_name(f"{folder.name}.libs").glob("*openblas*"), *folder.glob(".dylibs/*openblas*")):
            library = ctypes.CDLL(str(path))
            for name in _NAMES:
                if hasattr(library, name.format("set")):
                    found.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
                    break
    return found
