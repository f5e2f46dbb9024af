"""A backend in a process of its own, because OpenGL calls hold Python's lock for as long as they take.

In a thread of the server's process a picture of 100 ms would keep the event loop from reading requests and from sending
pictures that are ready. Here it only waits for a pipe. Pictures come through shared memory; what is covered is copied,
the rest of a picture is zero already. A driver that crashes or hangs takes its process with it, not the server.
"""

from __future__ import annotations

import atexit
import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

import numpy as np

from glsplat.errors import ContextError, ContextLostError, GlsplatError
from glsplat.net.backend import Backend, Interruptible, Placing, Rendered, RenderJob
from glsplat.net.worker.slots import Slots, SlotWriter

__all__ = ["ProcessBackend"]

_OPEN = 60.0  # seconds to make a context and load a scene
_HANG = 10.0  # seconds beyond what a picture may take after which it will not come any more
_CLOSE = 5.0
_LOOK = 0.05  # seconds between two looks whether a picture is still wanted


class ProcessBackend:
    """Runs what ``make()`` returns in a process of its own. ``max_side`` bounds the pictures (pixels, one or two eyes).

    ``make`` is pickled: a class or a partial of one, with picklable arguments. ``seconds`` is what it lets a picture
    take; one that takes far longer hangs, and its process is ended.
    """

    def __init__(self, make: Callable[[], Backend], max_side: int, seconds: float = 5.0) -> None:
        self.abandoned: Callable[[], bool] = lambda: False
        self._make, self._seconds = make, seconds
        self._slot_bytes = 2 * max_side * max_side * 4
        self._process: SpawnProcess | None = None
        self._number = 0  # of the picture
        self._hangs = False

    @property
    def free_slots(self) -> int:
        """Pictures that can be drawn before one has to be done with."""
        return self._slots.free

    def open(self) -> str:
        """Start the process. Raises what the backend's ``open`` raises; ContextLostError if it dies of it."""
        spawn = multiprocessing.get_context("spawn")
        self._hangs = False
        self._slots = Slots(self._slot_bytes)
        try:
            self._pipe, theirs = spawn.Pipe()
            arguments = (self._make, theirs, self._slots.path, self._slots.nbytes)
            process = spawn.Process(target=_work, args=arguments, name="glsplat renderer", daemon=True)
            process.start()
            self._process = process
            atexit.register(self.close)  # before multiprocessing waits for its children
            theirs.close()
            driver: str = self._answer(_OPEN)
        except BaseException as error:
            self.close()
            self._slots.close()
            if isinstance(error, OSError):
                raise ContextError(f"the renderer's process cannot be started: {error.strerror}") from None
            raise
        finally:
            self._slots.unlink()
        return driver

    def render(self, job: RenderJob) -> Rendered:
        """Draw; the pictures lie in shared memory until ``done`` of what is returned is called, once."""
        slots, camera = self._slots, job.cameras[0]
        shape = (len(job.cameras), camera.height, camera.width, 4)
        nbytes = int(np.prod(shape))
        if nbytes > self._slot_bytes:
            raise GlsplatError(f"{camera.width}x{camera.height} pixels are more than the server was started for")
        slot = slots.take(nbytes)
        try:
            self._number += 1
            try:
                self._pipe.send((self._number, slot, shape, job))
            except OSError:
                raise ContextLostError("the renderer's process has ended") from None
            rendered = self._answer(self._seconds + _HANG, self._number)
        except BaseException:
            slots.give_back(slot)
            raise
        # the slots of this process: a later one has its own
        return replace(rendered, images=slots.picture(slot, shape), done=partial(slots.give_back, slot))

    def kill(self) -> None:
        """End the process, hung or not; a ``render`` or ``open`` under way raises ContextLostError. From any thread."""
        process = self._process
        if process is not None:
            with suppress(ValueError):  # closed meanwhile
                process.kill()

    def close(self) -> None:
        """End the process, by force if it does not listen."""
        if self._process is None:
            return
        atexit.unregister(self.close)
        if self._hangs:
            self._process.kill()
        else:
            with suppress(OSError):
                self._pipe.send(None)
            self._process.join(_CLOSE)
        if self._process.is_alive():
            self._process.kill()
        self._process.join()
        self._pipe.close()
        self._process.close()
        self._process = None
        self._slots.close()

    def _answer(self, seconds: float, number: int | None = None) -> Any:
        """What the process sends next; for a picture of that ``number`` it is told when nobody wants it any more."""
        until = time.monotonic() + seconds
        try:
            while not self._pipe.poll(max(0.0, min(_LOOK, until - time.monotonic()))):
                if time.monotonic() >= until:
                    self._hangs = True
                    raise ContextLostError(f"the renderer did not answer within {seconds:g} s")
                if number is not None and self.abandoned():
                    self._slots.abandon(number)
            answer = self._pipe.recv()
        except (EOFError, OSError):
            raise ContextLostError("the renderer's process has ended") from None
        if isinstance(answer, Exception):
            raise answer
        return answer


def _work(make: Callable[[], Backend], pipe: Connection, path: str, nbytes: int) -> None:
    """The process: a driver string or an error, then an answer for each job until None comes or the pipe ends."""
    for signal_number in (signal.SIGINT, signal.SIGTERM):  # they may reach all processes; the server ends this one
        signal.signal(signal_number, signal.SIG_IGN)
    slots = SlotWriter(path, nbytes)
    backend = make()
    try:
        pipe.send(backend.open())
    except GlsplatError as error:
        pipe.send(error)
        return
    with suppress(EOFError, OSError):
        while (task := pipe.recv()) is not None:
            number, slot, shape, job = task
            if isinstance(backend, Interruptible):
                backend.abandoned = partial(slots.abandoned, number)
            try:
                if isinstance(backend, Placing):
                    backend.place = slots.place(slot, shape)
                rendered = backend.render(job)
                slots.put(slot, rendered, shape)
                pipe.send(replace(rendered, images=np.empty(0, np.uint8)))
            except GlsplatError as error:
                pipe.send(error)
            except Exception:
                pipe.send(RuntimeError(traceback.format_exc()))  # for the server's log
    backend.close()
