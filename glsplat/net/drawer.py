"""Drawer: what the server needs of a render loop or of a pool of workers. One event loop calls all of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from glsplat.net.client_stream import Answer, ClientStream, Outgoing
from glsplat.net.pace.stages import StageTimes
from glsplat.net.worker.encoding import PictureEncoder

__all__ = ["Drawer"]


class Drawer(Protocol):
    """Draws for the clients that were added, in fair turns, and packs their replies."""

    stages: StageTimes
    should_yield: Callable[[], bool]  # set by the server: returns whether others need the processor that draws
    encoder: PictureEncoder  # of pixels, and of video

    @property
    def driver(self) -> str:
        """The OpenGL driver; several are joined by "; "."""
        ...

    @property
    def healthy(self) -> bool:
        """False once pictures fail in a row, one hangs, or no worker is left."""
        ...

    @property
    def rebuilds(self) -> int:
        """Contexts or workers lost so far."""
        ...

    @property
    def drawing_for(self) -> float:
        """Seconds that the newest picture in hand has taken so far; 0: none is drawn."""
        ...

    @property
    def restart(self) -> Callable[[], asyncio.Task[None]] | None:
        """Starts the workers anew, one by one; None where there are none."""
        ...

    async def start(self) -> None:
        """Open the workers. Raises GlsplatError."""
        ...

    async def ended(self) -> None:
        """Wait until no worker can be started any more. Raises ContextError."""
        ...

    async def stop(self) -> None:
        """Close the workers."""
        ...

    def add(self, client: ClientStream) -> None:
        """Draw for a client from now on."""
        ...

    def remove(self, client: ClientStream) -> None:
        """Forget a client."""
        ...

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return an answer as it is sent, and mark it as being sent."""
        ...

    def workers(self) -> list[dict[str, Any]] | None:
        """Return ``workers`` of /stats; None where there are none."""
        ...
