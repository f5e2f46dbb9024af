"""ThreadProxy: an object on a thread of its own, for programs that call from many (renderer.RendererThread)."""

from __future__ import annotations

import functools
import inspect
import sys
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, Self, TypeVar

from glsplat.errors import GlsplatError

__all__ = ["ThreadProxy"]


class _Owner(Protocol):
    def release(self) -> None: ...


P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R", bound=_Owner)


class ThreadProxy(Generic[R]):
    """Has every public method, property and attribute of ``of``, done on the thread: nothing is written twice."""

    def __init_subclass__(cls, of: type[R], **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in dir(of):
            if not (name.startswith("_") or hasattr(ThreadProxy, name)):
                member = inspect.getattr_static(of, name)
                if inspect.isfunction(member):
                    setattr(cls, name, _method(member))
                elif isinstance(member, property):
                    setattr(cls, name, property(functools.partial(_read, name), doc=member.__doc__))

    def __init__(self, make: Callable[..., R], scene: object, options: dict[str, Any]) -> None:
        if options.get("context") is not None:
            raise GlsplatError("run_in_thread() makes a context on its own thread; leave context out")
        self._pool = ThreadPoolExecutor(1, "glsplat renderer")
        self._turn = threading.RLock()  # of those who ask and release: nobody asks a pool that was shut down
        self._alive = True
        try:
            self._thread: int = self._pool.submit(threading.get_ident).result()
            self._made: R = self._pool.submit(make, scene, **options).result()
        except BaseException:
            self._alive = False
            self._pool.shutdown()
            raise

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return _read(name, self)

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_"):
            super().__setattr__(name, value)
        else:
            self.submit(setattr, name, value).result()

    def submit(self, function: Callable[Concatenate[R, P], T], *arguments: P.args, **options: P.kwargs) -> Future[T]:
        """``function(renderer, ...)`` on the renderer's thread, such as ``submit(Renderer.render, [camera])``.

        With asyncio: ``await asyncio.wrap_future(thread.submit(...))``.
        """
        with self._turn:
            if not self._alive:
                raise GlsplatError("this renderer was released; make a new one")
            if threading.get_ident() != self._thread:
                return self._pool.submit(function, self._made, *arguments, **options)
        done: Future[T] = Future()
        try:
            done.set_result(function(self._made, *arguments, **options))
        except BaseException as error:
            done.set_exception(error)
        return done

    def release(self) -> None:
        """Finish what was asked for, delete every GL object and end the thread. May be called twice.

        Called on the thread itself it returns before that is done.
        """
        with self._turn:
            if not self._alive:
                return
            self._alive = False
            done = self._pool.submit(self._made.release)
        here = threading.get_ident() == self._thread
        self._pool.shutdown(wait=not here)
        if not here:
            done.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def __del__(self) -> None:
        if getattr(self, "_alive", False) and not sys.is_finalizing():
            self._alive = False
            self._pool.submit(self._made.release)
            self._pool.shutdown(wait=False)
            warnings.warn(
                "a RendererThread was never released; call release() or use a with block", ResourceWarning, 2, self
            )


def _method(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(self: ThreadProxy[Any], *arguments: Any, **options: Any) -> Any:
        return self.submit(function, *arguments, **options).result()

    return call


def _read(name: str, thread: ThreadProxy[Any]) -> Any:
    return thread.submit(getattr, name).result()
