"""Where a worker is: how it is started, reached and ended there. Processes of this machine, or Ray's actors."""

from __future__ import annotations

import socket
from typing import Protocol

__all__ = ["WorkerLauncher"]


class WorkerLauncher(Protocol):
    """Holds one worker at a time; a new one is started where the last has ended."""

    name: str
    """For people: in the log and in /stats."""

    async def start(self) -> tuple[socket.socket, bytes]:
        """A new worker's connection after the handshake, and its key. Raises GlsplatError."""
        ...

    async def cause(self) -> tuple[str, bool]:
        """Why the worker's connection ended, in a line, and whether what it drew is likely to be at fault."""
        ...

    def stopped(self) -> bool:
        """Whether somebody has stopped the worker's process, so that no picture is why it is silent."""
        ...

    async def end(self, seconds: float) -> None:
        """Wait so long for the worker to end of itself, then end it by force. Harmless where there is none."""
        ...
