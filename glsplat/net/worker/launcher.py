"""Launchers: how a worker is started, reached and ended. As a process of this machine, or as an actor of Ray."""

from __future__ import annotations

import socket
from typing import Protocol

from glsplat.net.worker.slots import Slots

__all__ = ["WorkerLauncher"]


class WorkerLauncher(Protocol):
    """Holds one worker at a time; a new one is started where the last has ended."""

    name: str
    """For people: in the log and in /stats."""

    @property
    def slots(self) -> Slots | None:
        """Memory that the worker shares with this process, for the pixels; None: it sends JPEGs."""
        ...

    async def start(self) -> tuple[socket.socket, bytes]:
        """Start a worker; return its connection after the handshake, and its key. Raises GlsplatError."""
        ...

    async def cause(self) -> tuple[str, bool]:
        """Return why the worker's connection ended, in a line, and whether its picture is likely to be at fault."""
        ...

    def stopped(self) -> bool:
        """Return whether somebody has stopped the worker's process, so that no picture is why it is silent."""
        ...

    async def end(self, seconds: float) -> None:
        """Wait ``seconds`` for the worker to end, then end it by force. Harmless where there is none."""
        ...
