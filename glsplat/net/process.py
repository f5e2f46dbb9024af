"""A backend in a process of its own, because OpenGL calls hold Python's lock for as long as they take.

In a thread of the server's process a picture of 100 ms would keep the event loop from reading requests and from sending
pictures that are ready. Here it only waits for a pipe. Pictures come through shared memory; what is covered is copied,
the rest of a picture is zero already. A driver that crashes or hangs takes its process with it, not the server.
"""

from __future__ import annotations

import atexit
import mmap
import multiprocessing
import os
import queue
import shutil
import signal
import tempfile
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import Backend, Rendered
from glsplat.net.messages import RenderRequest

__all__ = ["ProcessBackend"]

_SLOTS = 3  # pictures: one being drawn, two being encoded
_OPEN = 60.0  # seconds to make a context and load a scene
_HANG = 15.0  # seconds after which a picture will not come any more
_CLOSE = 5.0
_SHM = "/dev/shm"


class ProcessBackend:
    """Runs what ``make()`` returns in a process of its own. ``max_side`` bounds the pictures (pixels, one or two eyes).

    ``make`` is pickled: a class or a partial of one, with picklable arguments.
    """

    def __init__(self, make: Callable[[], Backend], max_side: int) -> None:
        self._make = make
        self._slot_bytes = 2 * max_side * max_side * 4
        self._process: SpawnProcess | None = None

    def open(self) -> str:
        """Start the process. Raises what the backend's ``open`` raises; ContextError if it dies of it."""
        spawn = multiprocessing.get_context("spawn")
        total = self._slot_bytes * _SLOTS
        roomy = os.path.isdir(_SHM) and shutil.disk_usage(_SHM).free > total  # containers often have 64 MB there
        with tempfile.NamedTemporaryFile(prefix="glsplat-", dir=_SHM if roomy else None) as file:
            file.truncate(total)
            self._slots = np.frombuffer(mmap.mmap(file.fileno(), total), np.uint8).reshape(_SLOTS, -1)
            self._free: queue.SimpleQueue[int] = queue.SimpleQueue()
            for slot in range(_SLOTS):
                self._free.put(slot)
            self._pipe, theirs = spawn.Pipe()
            arguments = (self._make, theirs, file.name, total)
            self._process = spawn.Process(target=_work, args=arguments, name="glsplat renderer", daemon=True)
            self._process.start()
            atexit.register(self.close)  # before multiprocessing waits for its children
            theirs.close()
            try:
                driver: str = self._answer(_OPEN)
            except BaseException:
                self.close()
                raise
        return driver

    def render(self, request: RenderRequest) -> Rendered:
        """Draw; the pictures lie in shared memory until ``done`` of what is returned is called."""
        slot = self._free.get()
        try:
            try:
                self._pipe.send((slot, replace(request, tracking=None)))
            except OSError:
                raise ContextError("the renderer's process has ended") from None
            rendered, shape = self._answer(_HANG)
        except BaseException:
            self._free.put(slot)
            raise
        images = self._slots[slot, : int(np.prod(shape))].reshape(shape)
        return replace(rendered, images=images, done=partial(self._free.put, slot))

    def close(self) -> None:
        """End the process, by force if it does not listen."""
        if self._process is None:
            return
        atexit.unregister(self.close)
        with suppress(OSError):
            self._pipe.send(None)
        self._process.join(_CLOSE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._pipe.close()
        self._process.close()
        self._process = None

    def _answer(self, seconds: float) -> Any:
        try:
            if not self._pipe.poll(seconds):
                raise ContextError(f"the renderer did not answer within {seconds:g} s")
            answer = self._pipe.recv()
        except (EOFError, OSError):
            raise ContextError("the renderer's process has ended") from None
        if isinstance(answer, Exception):
            raise answer
        return answer


def _work(make: Callable[[], Backend], pipe: Connection, path: str, size: int) -> None:
    """The process: a driver string or an error, then an answer for each request until None comes or the pipe ends."""
    for number in (signal.SIGINT, signal.SIGTERM):  # they may reach all processes; the server ends this one in order
        signal.signal(number, signal.SIG_IGN)
    with open(path, "r+b") as file:
        slots = _Slots(np.frombuffer(mmap.mmap(file.fileno(), size), np.uint8))
    backend = make()
    try:
        pipe.send(backend.open())
    except GlsplatError as error:
        pipe.send(error)
        return
    with suppress(EOFError, OSError):
        while (task := pipe.recv()) is not None:
            slot, request = task
            try:
                rendered = backend.render(request)
                slots.put(slot, rendered)
                pipe.send((replace(rendered, images=np.empty(0, np.uint8)), rendered.images.shape))
            except GlsplatError as error:
                pipe.send(error)
            except Exception:
                pipe.send(RuntimeError(traceback.format_exc()))  # for the server's log
    backend.close()


class _Slots:
    """Pictures in shared memory, of which only what is covered is written."""

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self._slots = memory.reshape(_SLOTS, -1)
        self._dirty: dict[int, NDArray[np.uint8]] = {}  # by slot: what its last picture covered

    def put(self, slot: int, rendered: Rendered) -> None:
        """Zero what the slot's last picture covered, copy what this one covers."""
        images = rendered.images
        _, height, width, _ = images.shape
        if images.nbytes > self._slots.shape[1]:
            raise GlsplatError(f"{width}x{height} pixels are more than the server was started for")
        if slot in self._dirty:
            self._dirty[slot].fill(0)
        x, y, w, h = rendered.covered or (0, 0, width, height)
        covered = self._slots[slot, : images.nbytes].reshape(images.shape)[:, y : y + h, x : x + w]
        covered[...] = images[:, y : y + h, x : x + w]
        self._dirty[slot] = covered
