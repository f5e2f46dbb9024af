"""RendererThread: a renderer on a thread of its own, for programs that call from many."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.errors import GlsplatError
from glsplat.skinning.pose import Pose

__all__ = ["RendererThread"]


class _Renderer(Protocol):
    """What is asked of glsplat.renderer.Renderer here."""

    def render(
        self, cameras: Sequence[Camera], pose: Pose | None = None, *, sort_viewmat: NDArray[np.float64] | None = None
    ) -> NDArray[Any]: ...

    def release(self) -> None: ...


P = ParamSpec("P")
T = TypeVar("T")
R = TypeVar("R", bound=_Renderer)


class RendererThread(Generic[R]):
    """Made by ``Renderer.run_in_thread()``. Every method may be called on any thread; calls are done one by one."""

    def __init__(self, make: Callable[..., R], scene: object, options: dict[str, Any]) -> None:
        if options.get("context") is not None:
            raise GlsplatError("run_in_thread() makes a context on its own thread; leave context out")
        self._pool = ThreadPoolExecutor(1, "glsplat renderer")
        self._open = True
        try:
            self._renderer: R = self._pool.submit(make, scene, **options).result()
        except BaseException:
            self._open = False
            self._pool.shutdown()
            raise

    def submit(self, function: Callable[Concatenate[R, P], T], *arguments: P.args, **options: P.kwargs) -> Future[T]:
        """``function(renderer, ...)`` on the renderer's thread, such as ``submit(Renderer.render, [camera])``.

        With asyncio: ``await asyncio.wrap_future(thread.submit(...))``.
        """
        if not self._open:
            raise GlsplatError("this renderer was released; make a new one")
        return self._pool.submit(function, self._renderer, *arguments, **options)

    def render(
        self,
        cameras: Sequence[Camera],
        pose: Pose | None = None,
        *,
        sort_viewmat: NDArray[np.float64] | None = None,
    ) -> NDArray[Any]:
        """Renderer.render(), waited for."""
        return self.submit(lambda renderer: renderer.render(cameras, pose, sort_viewmat=sort_viewmat)).result()

    def release(self) -> None:
        """Finish what was asked for, delete every GL object and end the thread. May be called twice."""
        if self._open:
            self._open = False
            done = self._pool.submit(self._renderer.release)
            self._pool.shutdown()
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
