"""RendererThread: a renderer on a thread of its own, for programs that call from many."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Callable, Collection, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, Concatenate, Generic, Literal, ParamSpec, Protocol, TypedDict, TypeVar, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.passes.frame.budget import Budget
from glsplat.scene import Item
from glsplat.skinning.pose import Pose
from glsplat.watermark.mark import Mark

__all__ = ["RenderOptions", "RendererThread"]

Depths = tuple[NDArray[Any], NDArray[np.float32]]


class RenderOptions(TypedDict, total=False):
    """What ``Renderer.render`` takes by name, but for ``depth``, which decides what it returns."""

    sort_viewmat: ArrayLike | None
    budget: Budget | None
    out: NDArray[Any] | None
    viewer: Hashable
    lod_bias: float
    without: Collection[Item]
    mark: Mark | None


class _Renderer(Protocol):
    """What is asked of glsplat.renderer.Renderer here."""

    @property
    def render(self) -> Callable[..., Any]: ...

    def release(self) -> None: ...


P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R", bound=_Renderer)


class RendererThread(Generic[R]):
    """Made by ``Renderer.run_in_thread()``. Every method may be called on any thread; calls are done one by one.

    What is called on the renderer's own thread, by a function given to ``submit``, is done at once: it would wait for
    itself.
    """

    def __init__(self, make: Callable[..., R], scene: object, options: dict[str, Any]) -> None:
        if options.get("context") is not None:
            raise GlsplatError("run_in_thread() makes a context on its own thread; leave context out")
        self._pool = ThreadPoolExecutor(1, "glsplat renderer")
        self._turn = threading.RLock()  # of those who ask and release: nobody asks a pool that was shut down
        self._open = True
        try:
            self._thread: int = self._pool.submit(threading.get_ident).result()
            self._renderer: R = self._pool.submit(make, scene, **options).result()
        except BaseException:
            self._open = False
            self._pool.shutdown()
            raise

    def submit(self, function: Callable[Concatenate[R, P], T], *arguments: P.args, **options: P.kwargs) -> Future[T]:
        """``function(renderer, ...)`` on the renderer's thread, such as ``submit(Renderer.render, [camera])``.

        With asyncio: ``await asyncio.wrap_future(thread.submit(...))``.
        """
        with self._turn:
            if not self._open:
                raise GlsplatError("this renderer was released; make a new one")
            if threading.get_ident() != self._thread:
                return self._pool.submit(function, self._renderer, *arguments, **options)
        done: Future[T] = Future()
        try:
            done.set_result(function(self._renderer, *arguments, **options))
        except BaseException as error:
            done.set_exception(error)
        return done

    @overload
    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = ...,
        *,
        depth: Literal[False] = ...,
        **options: Unpack[RenderOptions],
    ) -> NDArray[Any]: ...

    @overload
    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = ...,
        *,
        depth: Literal[True],
        **options: Unpack[RenderOptions],
    ) -> Depths: ...

    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = None,
        *,
        depth: bool = False,
        **options: Unpack[RenderOptions],
    ) -> NDArray[Any] | Depths:
        """Renderer.render(), waited for."""
        return self.submit(lambda renderer: renderer.render(cameras, pose, depth=depth, **options)).result()

    def release(self) -> None:
        """Finish what was asked for, delete every GL object and end the thread. May be called twice.

        Called on the thread itself it returns before that is done.
        """
        with self._turn:
            if not self._open:
                return
            self._open = False
            done = self._pool.submit(self._renderer.release)
        here = threading.get_ident() == self._thread
        self._pool.shutdown(wait=not here)
        if not here:
            done.result()

    def __enter__(self) -> RendererThread[R]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def __del__(self) -> None:
        if getattr(self, "_open", False) and not sys.is_finalizing():
            self._open = False
            self._pool.submit(self._renderer.release)
            self._pool.shutdown(wait=False)
            warnings.warn(
                "a RendererThread was never released; call release() or use a with block", ResourceWarning, 2, self
            )
