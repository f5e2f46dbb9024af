"""Clients that come, go and misbehave by the hundred over real sockets: nothing of them stays."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import threading

import numpy as np
import psutil
import pytest

from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from tests.net.conftest import eyes
from tests.net.wire import UNLIMITED, UPGRADE, all_of, frame, native, raw, still_serves, until

pytestmark = pytest.mark.check


@pytest.mark.parametrize("moment", ["half a request sent", "its picture is drawn", "its picture is written"])
async def test_a_client_lost_in_the_middle_of_a_frame(serve, fake_backend, cameras, moment):
    """The picture goes nowhere, the next client is served."""
    backend = fake_backend(noise=moment == "its picture is written")
    size = [1536, 1536] if backend.noise else [64, 64]  # more than a socket takes of what nobody reads
    data = frame(0x1, native(1, size=size, quality=100).encode())
    data = data[:100] if moment.startswith("half") else data
    async with serve(backend) as server:
        happened = {
            "half a request sent": lambda: server.stats()["clients"],
            "its picture is drawn": lambda: backend.drawn,
            "its picture is written": lambda: server.stats()["stages"],
        }[moment]
        if moment == "its picture is drawn":
            backend.gate.clear()
        _, writer = await raw(server)
        writer.transport.pause_reading()
        writer.write(data)
        await until(happened)
        writer.transport.abort()
        backend.gate.set()
        assert await still_serves(server, cameras)
        await until(lambda: not server.stats()["clients"])
        stats = server.stats()
    assert stats["healthy"] and stats["totals"]["failed"] == 0
    assert len(backend.drawn) == (1 if moment.startswith("half") else 2)


async def visit(server, i):
    """Come and go in one of ten manners; False: turned away."""
    if i % 5 == 4:  # leaves before it has said all
        _, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(UPGRADE[: 10 + i % 60])
    else:
        try:
            _, writer = await raw(server)
        except AssertionError:  # 503: the eight before it are still being put away
            return False
        if i % 5 < 2:
            writer.write(frame(0x1, native(1).encode()))
        if i % 5 == 2:
            writer.write(frame(0x8, b"\x03\xe8"))
    if i % 2:
        writer.transport.abort()
    writer.close()
    return True


async def test_hundreds_of_connections_leave_nothing_behind(serve, fake_backend, cameras):
    """No client, task, thread, file or object stays."""
    process, backend = psutil.Process(), fake_backend()

    def held():
        backend.drawn.clear()
        gc.collect()
        return len(asyncio.all_tasks()), process.num_fds(), len(gc.get_objects())

    async def visits(number):
        done = i = 0
        while done < number and i < 5 * number:
            done += await visit(server, i)
            i += 1
        await until(lambda: not server.stats()["clients"])

    async with serve(backend, ServerConfig(port=0, limits=UNLIMITED)) as server:
        await visits(100)
        before, threads = held(), threading.active_count()
        await visits(600)
        with contextlib.suppress(TimeoutError):
            await until(lambda: held()[:2] <= before[:2])
        tasks, files, objects = held()
        assert tasks <= before[0] and files <= before[1] and objects - before[2] < 550, (before, held())
        assert threading.active_count() <= threads + 5  # the pools start theirs when they are first needed
        assert await still_serves(server, cameras)


async def watch(url, side, frames):
    """Check that each picture is this client's own, by its size, and the one its frame_id says, by its grey."""
    async with Client(url) as client:
        for frame_id in range(1, frames + 1):
            reply = await client.render(eyes(side), quality=95)
            for image in reply.images():
                assert image.shape == (side, side, 3)
                assert abs(np.median(image[image > 25]) - frame_id - 50) <= 2


async def test_eight_clients_one_of_them_misbehaving(serve):
    """Seven get every one of their own pictures."""

    async def misbehave():
        for _ in range(10):
            reader, writer = await raw(server)
            writer.writelines(frame(0x1, text.encode()) for text in (native(1), "{", native(5, quality=0)))
            writer.write(frame(0x2, b"\0" * 1000) + b"\xff\xff")
            await all_of(reader)  # the last of them ended it
            writer.transport.abort()

    async with serve() as server:
        await asyncio.gather(*(watch(server.url, 48 + 8 * i, 20) for i in range(7)), misbehave())
        assert server.stats()["totals"]["malformed"] == 30
