"""A renderer for workers whose pictures say whose they are, and clients that look at that."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from glsplat.camera import Camera
from glsplat.errors import BudgetError, ContextError, FormatError, PoseError, ProtocolError
from glsplat.net.backend import Rendered
from glsplat.net.client import Client
from glsplat.net.messages import RenderRequest
from glsplat.net.workers.farm import Farm
from glsplat.net.workers.local import ProcessPlace

SIDE = 64
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

    def render(self, request: RenderRequest) -> Rendered:
        camera = request.cameras[0]
        act = int(camera.K[0, 2])
        if request.avatar and request.avatar == self._without:
            raise FormatError(f"{request.avatar}.glb: not on this machine")
        if act == 90:
            os.kill(os.getpid(), signal.SIGSEGV)
        if act == 70:
            time.sleep(60)
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
        for _ in range(300):
            if self.abandoned():
                raise BudgetError("abandoned", "abandoned")
            time.sleep(0.02)

    def kill(self) -> None: ...

    def close(self) -> None: ...


def _grey(number: int) -> int:
    return number % 32 * STEP


def farm(count: int = 2, patience: float = 0.0, makes: Sequence[Callable[[], Sleeper]] = (), **options) -> Farm:
    """Of processes."""
    made = list(makes) or [partial(Sleeper, **options)] * count
    return Farm([ProcessPlace(make, f"worker {i}") for i, make in enumerate(made, 1)], patience=patience)


def camera(number: int, act: int = 32) -> Camera:
    """Of the client with that number."""
    return Camera(np.eye(4), np.array([[number, 0, act], [0, 50.0, 32], [0, 0, 1]]), SIDE, SIDE)


@dataclass
class Seen:
    """What a client saw."""

    pictures: int = 0
    errors: list[str] = field(default_factory=list)
    drivers: dict[str, int] = field(default_factory=dict)
    longest: float = 0.0  # seconds between two pictures
    wrong: list[tuple[int, int, int, int]] = field(default_factory=list)


def look(number: int, reply, last: int, seen: Seen) -> None:
    """Whether the picture is this client's, of this frame, and in order."""
    image = reply.images()[0]
    left, right = (round(float(half.mean()) / STEP) for half in np.array_split(image[..., 0], 2, axis=1))
    if (left, right) != (number % 32, reply.frame_id % 32) or reply.frame_id <= last:
        seen.wrong.append((reply.frame_id, last, left, right))
    seen.pictures += 1
    seen.drivers[reply.info["driver"]] = seen.drivers.get(reply.info["driver"], 0) + 1


async def watch(url: str, number: int, until: asyncio.Event, again: bool = False, **options) -> Seen:
    """Ask for pictures, two under way, until ``until``; with ``again`` connect anew where the connection ends."""
    seen, last, at = Seen(), 0, time.perf_counter()
    client = Client(url, timeout=8, **options)
    while not until.is_set():
        try:
            await client.connect()
            while not until.is_set():
                while client.newest - last < 2:
                    await client.send([camera(number)])
                reply = (await client.receive()).reply
                now = time.perf_counter()
                seen.longest, at = max(seen.longest, now - at), now
                look(number, reply, last, seen)
                last = reply.frame_id
        except ProtocolError as error:
            seen.errors.append(f"{error.code}: {error}")
            if error.code in ("closed", "timeout", "unreachable", "refused") and not again:
                break
            if error.code in ("closed", "unreachable", "refused"):
                last = 0
                await asyncio.sleep(0.05)
            else:
                last = client.newest
    await client.close()
    seen.longest = max(seen.longest, time.perf_counter() - at)
    return seen
