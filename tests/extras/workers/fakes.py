"""Farms of sleeping workers, clients that check whose pictures they get, and waits."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest

from glsplat.camera import Camera
from glsplat.errors import ProtocolError
from glsplat.extras.workers.pool import WorkerPool
from glsplat.net.client import Client
from glsplat.net.server import Server
from glsplat.net.worker import connection, process
from glsplat.net.worker.process import ProcessLauncher
from tests.extras.workers.sleeper import STEP, Sleeper

SIDE = 64
GUARD = 60.0  # seconds that only keep a test from hanging


def pool(count: int = 2, patience: float = 0.0, makes: Sequence[Callable[[], Sleeper]] = (), **options) -> WorkerPool:
    """Of processes."""
    made = list(makes) or [partial(Sleeper, **options)] * count
    return WorkerPool([ProcessLauncher(make, f"worker {i}") for i, make in enumerate(made, 1)], patience=patience)


def camera(number: int, act: int = 32) -> Camera:
    """Of the client with that number."""
    return Camera(np.eye(4), np.array([[number, 0, act], [0, 50.0, 32], [0, 0, 1]]), SIDE, SIDE)


@dataclass
class Seen:
    """What a client saw."""

    pictures: int = 0
    errors: list[str] = field(default_factory=list)
    wrong: list[tuple[int, int, int, int]] = field(default_factory=list)


def look(number: int, reply, last: int, seen: Seen) -> None:
    """Whether the picture is this client's, of this frame, and in order."""
    image = reply.images()[0]
    left, right = (round(float(half.mean()) / STEP) for half in np.array_split(image[..., 0], 2, axis=1))
    if (left, right) != (number % 32, reply.frame_id % 32) or reply.frame_id <= last:
        seen.wrong.append((reply.frame_id, last, left, right))
    seen.pictures += 1


async def watch(url: str, number: int, over: asyncio.Event, seen: Seen) -> None:
    """Ask for pictures, two under way, until it is ``over``."""
    last = 0
    async with Client(url, timeout=GUARD) as client:
        while not over.is_set():
            try:
                while client.newest - last < 2:
                    await client.send([camera(number)])
                reply = (await client.receive()).reply
            except ProtocolError as error:
                seen.errors.append(f"{error.code}: {error}")
                if error.code in ("closed", "timeout"):
                    return
                last = client.newest
            else:
                look(number, reply, last, seen)
                last = reply.frame_id


@asynccontextmanager
async def watching(url: str, numbers: Iterable[int]) -> AsyncIterator[list[Seen]]:
    """Clients with these numbers, and what each has seen so far."""
    over, numbers = asyncio.Event(), list(numbers)
    seen = [Seen() for _ in numbers]
    tasks = [asyncio.create_task(watch(url, n, over, one)) for n, one in zip(numbers, seen, strict=True)]
    try:
        yield seen
    finally:
        over.set()
        await asyncio.gather(*tasks)


async def until(true: Callable[[], object]) -> bool:
    """Whether it came true."""
    end = time.monotonic() + GUARD
    while not true() and time.monotonic() < end:
        await asyncio.sleep(0.01)
    return bool(true())


async def until_more(seen: Sequence[Seen], count: int = 8) -> bool:
    """Whether each of them gets so many more pictures."""
    before = [one.pictures for one in seen]
    return await until(lambda: all(one.pictures >= n + count for one, n in zip(seen, before, strict=True)))


def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only a process that was stopped is given up: the others of a slow machine are late."""
    patience = connection.WorkerConnection._patience
    monkeypatch.setattr(
        connection.WorkerConnection,
        "_patience",
        lambda self: patience(self) + (0.0 if self._launcher.stopped() else GUARD),
    )
    monkeypatch.setattr(process, "_EXIT_S", GUARD)


def held(server: Server) -> asyncio.Event:
    """No worker is started anew until this is set: what is seen meanwhile is of those that live."""
    free = asyncio.Event()

    def hold(start):
        async def when_free():
            await free.wait()
            return await start()

        return when_free

    for worker in server.drawer._workers:
        worker.launcher.start = hold(worker.launcher.start)
    return free
