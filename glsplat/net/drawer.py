"""Drawer: what the server needs of a render loop or of a pool of workers. One event loop calls all of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from glsplat.net.backend import AvatarInfo, PoseSolver
from glsplat.net.client_stream import ANYTHING, ClientStream, Frame
from glsplat.net.messages import Request
from glsplat.net.pace.stages import StageTimes
from glsplat.net.session import Session

__all__ = ["Drawer"]


class Drawer(Protocol):
    """Draws for the clients that were added, in fair turns, and packs their replies."""

    codecs: tuple[str, ...]  # of video
    stages: StageTimes
    should_yield: Callable[[], bool]  # set by the server: do others need the processor that draws?

    @property
    def driver(self) -> str:
        """What draws; several drivers are joined by "; "."""
        ...

    @property
    def healthy(self) -> bool:
        """False once pictures fail in a row, one hangs, or nothing is left that could draw."""
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
        """Open what draws. Raises GlsplatError."""
        ...

    async def ended(self) -> None:
        """Wait until nothing can draw any more. Raises ContextError."""
        ...

    async def stop(self) -> None:
        """Close what draws."""
        ...

    def open(
        self,
        number: int,
        session: Session,
        solver: PoseSolver | None = None,
        address: str = "",
        shown: AvatarInfo = ANYTHING,
    ) -> ClientStream:
        """Return a client that is ``shown`` an avatar; nothing is drawn for it before ``add``."""
        ...

    def add(self, channel: ClientStream) -> None:
        """Let a client take part."""
        ...

    def remove(self, channel: ClientStream) -> None:
        """Forget a client."""
        ...

    def received(self, channel: ClientStream, request: Request | None) -> None:
        """Take note of a message of the client."""
        ...

    def wake(self, channel: ClientStream) -> None:
        """Take note of a request, or of room in the client's window."""
        ...

    async def pack(self, channel: ClientStream, frame: Frame) -> list[bytes] | str:
        """Return the messages of a frame: binary ones, or the text of an error."""
        ...

    def workers(self) -> list[dict[str, Any]] | None:
        """Return ``workers`` of /stats; None where there are none."""
        ...
