"""Drawer: what the server needs of a render loop or of a pool of workers. One event loop calls all of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Protocol

from glsplat.net.backend import PoseSolver
from glsplat.net.client_stream import Answer, ClientStream, Outgoing
from glsplat.net.guard.limits import Bucket, CpuShare
from glsplat.net.messages import Request
from glsplat.net.pace.stages import StageTimes
from glsplat.net.pose_queue import PoseQueue
from glsplat.net.worker.encoding import ClientVideo

__all__ = ["Drawer"]


class Drawer(Protocol):
    """Draws for the clients that were added, in fair turns, and packs their replies."""

    stages: StageTimes
    should_yield: Callable[[], bool]  # set by the server: returns whether others need the processor that draws

    @property
    def codecs(self) -> tuple[str, ...]:
        """Of video."""
        ...

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

    def pose_queue(
        self, solver: PoseSolver | None, share: CpuShare | None = None, samples: Bucket | None = None
    ) -> PoseQueue | None:
        """Return the queue of a new client's tracking samples, with its limits; None without a solver."""
        ...

    def video(self) -> ClientVideo | None:
        """Return the video of a new client; None where there is none."""
        ...

    def add(self, client: ClientStream) -> None:
        """Draw for a client from now on."""
        ...

    def remove(self, client: ClientStream) -> None:
        """Forget a client."""
        ...

    def received(self, client: ClientStream, request: Request | None) -> None:
        """Take note of a message of the client."""
        ...

    def wake(self, client: ClientStream) -> None:
        """Take note of a request, or of room in the client's window."""
        ...

    async def pack(self, client: ClientStream, answer: Answer) -> Outgoing:
        """Return an answer as it is sent, and mark it as being sent."""
        ...

    def workers(self) -> list[dict[str, Any]] | None:
        """Return ``workers`` of /stats; None where there are none."""
        ...
