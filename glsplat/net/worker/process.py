"""Workers that are processes of this machine."""

from __future__ import annotations

import asyncio
import atexit
import multiprocessing
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.context import SpawnProcess
from pathlib import Path

from glsplat.errors import ContextError
from glsplat.net.backend import Backend
from glsplat.net.worker.wire import WorkerLostError, greet
from glsplat.net.worker.work import GREETING, work

__all__ = ["ProcessLauncher"]

_GONE = 0.5  # seconds in which the end of a process is known after the end of its connection
_OUTSIDE = (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM))  # sent by somebody: no picture's fault


class ProcessLauncher:
    """Runs what ``make()`` returns in a process of its own. ``make`` is pickled, as for ProcessBackend."""

    def __init__(self, make: Callable[[], Backend], name: str = "worker") -> None:
        self.name: str = name
        self._make = make
        self._process: SpawnProcess | None = None
        self._connection: socket.socket | None = None  # until it is handed over
        self._starting = threading.Lock()

    async def start(self) -> tuple[socket.socket, bytes]:
        """Start the process. Raises ContextError, WorkerLostError if it ends at once."""
        key = await asyncio.to_thread(self._start)
        connection, self._connection = self._connection, None
        assert connection is not None
        return connection, key

    async def cause(self) -> tuple[str, bool]:
        """How the process ended: by a signal that somebody sent, or otherwise."""
        until = time.monotonic() + _GONE
        process, code = self._process, None
        with suppress(ValueError):  # it was ended from here
            while process is not None and (code := process.exitcode) is None and time.monotonic() < until:
                await asyncio.sleep(0.005)
        if code is None:
            return "the worker has closed its connection", False
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"the worker's process ended ({how})", -code not in _OUTSIDE

    def stopped(self) -> bool:
        """By SIGSTOP, or by a debugger: where the system tells."""
        try:
            assert self._process is not None
            stat = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="ascii", errors="replace")
        except (AssertionError, OSError, ValueError):
            return False
        return stat.rpartition(")")[2].split()[0] in "Tt"

    async def end(self, seconds: float) -> None:
        """Wait for the process, then kill it."""
        await asyncio.to_thread(self._end, seconds)

    def _end(self, seconds: float) -> None:
        with self._starting:  # where nobody waits for what is being started any more
            connection, self._connection = self._connection, None
            process, self._process = self._process, None
        if connection is not None:
            connection.close()
        if process is None:
            return
        atexit.unregister(process.kill)
        process.join(seconds)
        if process.is_alive():
            process.kill()
            process.join()
        process.close()

    def _start(self) -> bytes:
        with self._starting:
            return self._begin()

    def _begin(self) -> bytes:
        spawn = multiprocessing.get_context("spawn")
        ours, theirs = socket.socketpair()
        secret = secrets.token_bytes(32)
        process = spawn.Process(target=_work, args=(theirs, secret, self._make), name="glsplat worker", daemon=True)
        try:
            process.start()
        except OSError as error:
            ours.close()
            raise ContextError(f"a worker's process cannot be started: {error.strerror}") from None
        finally:
            theirs.close()
        self._process = process
        atexit.register(process.kill)  # before multiprocessing waits for its children
        try:
            ours.settimeout(6 * GREETING)  # it imports first
            key = greet(ours, secret, worker=False)
        except (EOFError, OSError):
            ours.close()
            raise WorkerLostError("a worker's process ended before it was ready") from None
        self._connection = ours
        return key


def _work(connection: socket.socket, secret: bytes, make: Callable[[], Backend]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):  # they may reach all processes; the gateway ends this one
        signal.signal(number, signal.SIG_IGN)
    hangup = getattr(signal, "SIGHUP", None)
    if hangup is not None:
        signal.signal(hangup, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        work(connection, secret, make)
