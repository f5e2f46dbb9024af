"""Worker: what a render loop needs of whatever draws. One event loop calls all of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from glsplat.net.backend import Rendered, RenderJob

__all__ = ["Worker"]


@runtime_checkable
class Worker(Protocol):
    """Draws one picture after the other: on a thread of this process, or in another one, on any machine."""

    name: str
    """For people, in the log and in /stats."""

    async def open(self, lost: Callable[[], None]) -> str:
        """Start; return the driver string. ``lost`` is called when the worker ends by itself. Raises GlsplatError."""
        ...

    async def draw(self, job: RenderJob, pixels: bool = False) -> Rendered:
        """Draw a picture; it has ``images``, or it is ``encoded`` by the worker unless ``pixels`` are asked for.

        One call at a time. Raises what ``Backend.render`` raises; ContextLostError where nothing can be drawn before
        ``rebuild``.
        """
        ...

    def cancel(self) -> None:
        """Give up the picture in hand, which is not needed any more."""
        ...

    async def rebuild(self) -> str:
        """Start anew what is lost or has to be replaced; return the driver string. Raises GlsplatError."""
        ...

    async def close(self) -> None:
        """End, after the picture in hand or without it; harmless where ``open`` failed."""
        ...
