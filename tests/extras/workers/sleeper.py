"""A renderer for workers whose pictures say whose they are. Imports little: it is imported in each worker."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from glsplat.errors import BudgetError, ContextError, FormatError, PoseError
from glsplat.net.backend import Rendered, RenderJob

if TYPE_CHECKING:
    from glsplat.net.codec.encoded import Encoded

__all__ = ["STEP", "Fragile", "FragileEncoder", "Sleeper"]

STEP = 8  # grey values between two numbers: JPEG moves a flat half by less


class Sleeper:
    """Sleeps, then draws the client's number into the left half and the frame's into the right.

    The number is the focal length; cx says what else happens. ``without`` is an avatar that cannot be loaded here,
    ``fails`` a file: while it is there, the renderer cannot be opened.
    """

    def __init__(self, seconds: float = 0.005, without: str = "", fails: str = "") -> None:
        self.abandoned: Callable[[], bool] = lambda: False
        self._seconds, self._without, self._fails = seconds, without, fails

    def open(self) -> str:
        if self._fails and os.path.exists(self._fails):
            raise ContextError("no EGL device here")
        return f"sleeper {os.getpid()}"

    def render(self, request: RenderJob) -> Rendered:
        camera = request.cameras[0]
        act = int(camera.K[0, 2])
        if request.avatar and request.avatar == self._without:
            raise FormatError(f"{request.avatar}.glb: not on this machine")
        if act == 90:
            os.kill(os.getpid(), signal.SIGSEGV)
        if act == 71:
            self._until_abandoned()
        if act == 93:
            raise PoseError("no such joint")
        if act == 94:
            raise ZeroDivisionError
        time.sleep(self._seconds)
        out = np.full((len(request.cameras), camera.height, camera.width, 4), 255, np.uint8)
        half = camera.width // 2
        out[:, :, :half, :3] = _grey(int(camera.K[0, 0]))
        out[:, :, half:, :3] = _grey(request.frame_id or 0)
        return Rendered(out, {"draw": 1.5})

    def _until_abandoned(self) -> None:
        for _ in range(6000):  # longer than any test waits
            if self.abandoned():
                raise BudgetError("abandoned", "abandoned")
            time.sleep(0.02)

    def close(self) -> None: ...


class Fragile(Sleeper):
    """Does not survive a picture that shows somebody called "eve" to others."""

    def render(self, request: RenderJob) -> Rendered:
        room = request.room
        if room is not None and request.others and any(p.name == "eve" and p.key != room.viewer for p in room.people):
            os.kill(os.getpid(), signal.SIGSEGV)
        return super().render(request)


class FragileEncoder(Sleeper):
    """Its worker does not survive the encoding of pictures of client 31."""

    def open(self) -> str:
        from glsplat.net.worker.encoding import PictureEncoder

        encode = PictureEncoder._jpegs

        def fragile(encoder: PictureEncoder, rendered: Rendered, *given: Any) -> Encoded:
            if rendered.images[0, 0, 0, 0] == _grey(31):
                os.kill(os.getpid(), signal.SIGSEGV)
            return encode(encoder, rendered, *given)

        PictureEncoder._jpegs = fragile  # type: ignore[method-assign]
        return super().open()


def _grey(number: int) -> int:
    return number % 32 * STEP
