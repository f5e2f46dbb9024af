"""Farms of sleeping workers, and clients that look whose pictures they get."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from glsplat.camera import Camera
from glsplat.errors import ProtocolError
from glsplat.net.client import Client
from glsplat.net.workers.farm import Farm
from glsplat.net.workers.local import ProcessPlace
from tests.net.workers.sleeper import STEP, Sleeper

SIDE = 64


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
