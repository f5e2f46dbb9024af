"""Drawer: the interface of a render loop and of a pool of workers. All methods are called on one event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from glsplat.net.client_stream import Answer, ClientStream, Outgoing
from glsplat.net.pace.stages import StageTimes
from glsplat.net.worker.encoding import PictureEncoder


class Drawer(Protocol):
    """Draws for its clients, in fair turns, and packs their replies."""

    clock: Callable[[], float]  # seconds; the server's clock too
    stages: StageTimes
    should_yield: Callable[[], bool]  # set by the server: returns whether others need the processor
    encoder: PictureEncoder  # of pixels, and of video

    @property
    def driver(self) -> str:
        """The OpenGL driver; several are joined by "; "."""

    @property
    def healthy(self) -> bool:
        """False once pictures fail in a row, one hangs, or no worker is left."""

    @property
    def rebuilds(self) -> int:
        """Contexts or workers lost so far."""

    @property
    def drawing_for(self) -> float:
        """Seconds that the newest picture has taken so far; 0: none is drawn."""

    @property
    def restart(self) -> Callable[[], asyncio.Task[None]] | None:
        """Function that restarts the workers one by one; None without a pool."""

    async def start(self) -> None:
        """Open the workers. Raises GlsplatError."""

    async def ended(self) -> None:
        """Wait until no worker can be restarted. Raises ContextError."""

    async def stop(self) -> None:
        """Close the workers."""

    def add(self, client: ClientStream) -> None:
        """Draw for a client from now on."""

    def remove(self, client: ClientStream) -> None:
        """Remove a client."""

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return the packed reply of an answer, and mark it as being sent."""

    def workers(self) -> list[dict[str, Any]] | None:
        """Return ``workers`` of /stats; None without a pool."""
