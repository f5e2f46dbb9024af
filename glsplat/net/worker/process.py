"""Workers in processes of this machine.

OpenGL calls hold Python's lock: on a thread of the server, a picture of 100 ms would block the event loop for as long.
A driver that crashes or hangs ends its own process, not the server.
"""

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
from glsplat.net.worker.remote import RemoteWorker
from glsplat.net.worker.slots import Slots
from glsplat.net.worker.wire import WorkerLostError, greet
from glsplat.net.worker.work import work_in_process

_EXIT_S = 0.5  # from the end of a worker's connection until its exit code is known
_IMPORT_S = 60.0  # for a new process to import its modules and answer
_SENT_SIGNALS = (
    signal.SIGTERM,
    getattr(signal, "SIGKILL", signal.SIGTERM),
)  # an operator sends these; the picture is not at fault


def process_worker(make: Callable[[], Backend], max_side: int, seconds: float = 5.0) -> RemoteWorker:
    """Return a worker that draws with ``make()`` in a process of its own; pictures come through shared memory.

    ``max_side`` limits the pictures (pixels, one or two eyes), ``seconds`` the time of one.
    """
    return RemoteWorker(ProcessLauncher(make, "the renderer", 2 * max_side * max_side * 4), seconds)


class ProcessLauncher:
    """Runs the backend that ``make()`` returns in a process of its own.

    ``make`` is pickled: a class or a partial of one, with picklable arguments. With ``slot_bytes`` the worker writes
    pixels into slots of that size instead of encoding.
    """

    def __init__(self, make: Callable[[], Backend], name: str = "worker", slot_bytes: int = 0) -> None:
        self.name: str = name
        self.slots: Slots | None = None
        self._make, self._slot_bytes = make, slot_bytes
        self._process: SpawnProcess | None = None
        self._connection: socket.socket | None = None  # until it is handed over
        self._starting = threading.Lock()

    async def start(self) -> tuple[socket.socket, bytes]:
        """Start the process. Raises ContextError; WorkerLostError if it ends at once."""
        key = await asyncio.to_thread(self._start)
        connection, self._connection = self._connection, None
        assert connection is not None
        return connection, key

    async def cause(self) -> tuple[str, bool]:
        """Return how the process ended, and whether its picture may be at fault: not after SIGTERM or SIGKILL."""
        until = time.monotonic() + _EXIT_S
        process, code = self._process, None
        with suppress(ValueError):  # ``end`` has closed it
            while process is not None and (code := process.exitcode) is None and time.monotonic() < until:
                await asyncio.sleep(0.005)
        if code is None:
            return "the worker has closed its connection", False
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return f"the worker's process ended ({how})", -code not in _SENT_SIGNALS

    def stopped(self) -> bool:
        """Return whether SIGSTOP or a debugger has stopped the process; False where the system does not report it."""
        try:
            assert self._process is not None
            stat = Path(f"/proc/{self._process.pid}/stat").read_text(encoding="ascii", errors="replace")
        except (AssertionError, OSError, ValueError):
            return False
        return stat.rpartition(")")[2].split()[0] in "Tt"

    async def end(self, seconds: float) -> None:
        """Wait ``seconds`` for the process to end, then kill it."""
        await asyncio.to_thread(self._end, seconds)

    def _end(self, seconds: float) -> None:
        with self._starting:  # waits for a process that is being started, to end it
            connection, self._connection = self._connection, None
            process, self._process = self._process, None
            slots, self.slots = self.slots, None
        if connection is not None:
            connection.close()
        if slots is not None:
            slots.close()
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
            self.slots = Slots(self._slot_bytes) if self._slot_bytes else None
            try:
                return self._begin(None if self.slots is None else (self.slots.path, self.slots.nbytes))
            finally:
                if self.slots is not None:
                    self.slots.unlink()

    def _begin(self, memory: tuple[str, int] | None) -> bytes:
        spawn = multiprocessing.get_context("spawn")
        ours, theirs = socket.socketpair()
        secret = secrets.token_bytes(32)
        arguments = (theirs, secret, self._make, memory)
        process = spawn.Process(target=work_in_process, args=arguments, name=f"glsplat {self.name}", daemon=True)
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
            ours.settimeout(_IMPORT_S)
            key = greet(ours, secret, worker=False)
        except (EOFError, OSError):
            ours.close()
            raise WorkerLostError("a worker's process ended before it was ready") from None
        self._connection = ours
        return key
