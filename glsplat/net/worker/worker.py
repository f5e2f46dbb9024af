"""Worker: the interface between a render loop and a renderer. All methods are called on one event loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from glsplat.net.backend import Rendered, RenderJob


@runtime_checkable
class Worker(Protocol):
    """Draws one picture after the other: on a thread of this process, or in another process on any machine."""

    name: str
    """For the log and /stats."""

    async def open(self, lost: Callable[[], None]) -> str:
        """Start; return the driver string. ``lost`` is called when the worker ends by itself. Raises GlsplatError."""

    async def draw(
        self, job: RenderJob, pixels: bool = False, submitted: Callable[[], None] = lambda: None
    ) -> Rendered:
        """Draw a picture. The result has ``images``; or ``encoded``, where the worker encodes, except with ``pixels``.

        One call at a time, and another one after ``submitted`` was called: the GPU still draws then. Raises the errors
        of ``Backend.render``; after ContextLostError call ``rebuild``.
        """

    def cancel(self) -> None:
        """Cancel the picture that was ordered last."""

    async def rebuild(self) -> str:
        """Restart; return the driver string. Raises GlsplatError."""

    async def close(self) -> None:
        """End, after the present picture or without it; harmless where ``open`` failed."""
