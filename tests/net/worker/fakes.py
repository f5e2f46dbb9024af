"""Backends for tests of workers: they are imported again in another process."""

from __future__ import annotations

import ctypes
import os
import signal
import time

import numpy as np

from glsplat.errors import BudgetError, ContextLostError, GlsplatError, PoseError
from glsplat.net.backend import Rendered, Submitted


class Boxed:
    """Draws a filled box whose place, size and colour come from the camera; does as the frame_id says."""

    def __init__(self, fails_to_open: Exception | None = None) -> None:
        self._fails = fails_to_open
        self.abandoned = lambda: False

    def open(self) -> str:
        if isinstance(self._fails, GlsplatError):
            raise self._fails
        if self._fails is not None:
            os._exit(3)
        return f"boxed {os.getpid()}"

    def render(self, request) -> Rendered:
        acts = {
            90: lambda: os.kill(os.getpid(), signal.SIGSEGV),
            69: lambda: ctypes.PyDLL(None).sleep(3600),  # holds the interpreter's lock, as a driver does
            70: lambda: time.sleep(3600),
            71: self._until_abandoned,
            92: lambda: 1 / 0,
        }
        errors = {93: PoseError("no such joint"), 94: ContextLostError("lost"), 95: GlsplatError("out of memory")}
        acts.get(request.frame_id, lambda: None)()
        if request.frame_id in errors:
            raise errors[request.frame_id]
        camera = request.cameras[0]
        out = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        x, y = int(camera.K[0, 2]), int(camera.K[1, 2])
        box = (x, y, 8, 4)
        out[:, y : y + 4, x : x + 8] = int(camera.K[0, 0])
        return Rendered(out, {"draw": 1.5}, covered=None if request.frame_id == 50 else box)

    def _until_abandoned(self) -> None:
        while not self.abandoned():
            time.sleep(0.02)
        raise BudgetError("abandoned", "abandoned")

    def close(self) -> None: ...


class Overlapped(Boxed):
    """A GPU draws the pictures: ``timings`` has how many were begun and collected when one was collected.

    It finishes after three looks; with 60 as frame_id only once another picture is begun. 96 loses the context.
    """

    def __init__(self) -> None:
        super().__init__()
        self.begun = self.collected = 0

    def submit(self, request) -> Submitted:
        rendered = self.render(request)
        self.begun += 1
        number, looks = self.begun, iter(range(3))

        def ready(seconds: float) -> bool:
            time.sleep(seconds)
            return self.begun > number if request.frame_id == 60 else next(looks, None) is None

        def collect() -> Rendered:
            rendered.timings.update(begun=float(self.begun), collected=float(self.collected))
            self.collected += 1
            if request.frame_id == 96:
                raise ContextLostError("lost")
            return rendered

        return Submitted(ready, collect)
