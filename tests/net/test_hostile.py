"""Floods, dead connections, killed clients and crowds over real sockets: counts, times and memory stay bounded."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import itertools
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import aiohttp
import numpy as np
import psutil
import pytest

from glsplat.camera import Camera
from glsplat.net.backend import Rendered
from glsplat.net.client import Client
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.wire import EYE, HANG, UNLIMITED, UPGRADE, all_of, frame, native, raw, still_serves, until

pytestmark = pytest.mark.check

ROOT = Path(__file__).parents[2]


class Flood(threading.Thread):
    """A client on a thread of its own that sends requests as fast as it can until it is told to leave or is cut off."""

    def __init__(self, port):
        super().__init__()
        self.port = port
        self.leave, self.cut_off, self.answers = threading.Event(), False, b""

    def run(self):
        with socket.create_connection(("127.0.0.1", self.port), timeout=HANG) as connection:
            connection.sendall(UPGRADE)
            assert b" 101 " in connection.recv(1000)
            try:
                for first in itertools.count(1, 100):
                    if self.leave.is_set():
                        break
                    texts = (native(i).encode() for i in range(first, first + 100))
                    connection.sendall(b"".join(frame(0x1, text) for text in texts))
                connection.shutdown(socket.SHUT_WR)
                while data := connection.recv(65536):
                    self.answers += data
            except OSError:  # reset, or not connected any more
                self.cut_off = True


def flooded(server):
    """What the flood, the second client, has brought about; None: it is gone."""
    return next((client for client in server.stats()["clients"] if client["id"] == 2), None)


def test_ten_thousand_requests_at_once_end_the_connection(serve, fake_backend, cameras, stopped):
    limits = SessionConfig()

    async def main():
        async with serve() as server, Client(server.url) as other:
            await other.render(cameras)
            flood = Flood(server.port)
            flood.start()
            await until(lambda: server.stats()["totals"]["limited"])
            await until(lambda: len(server.stats()["clients"]) == 1)
            flood.leave.set()
            await asyncio.to_thread(flood.join, HANG)
            return flood, (await other.render(cameras)).frame_id, server.stats()

    flood, pictures, stats = asyncio.run(main())
    assert flood.cut_off or b"too many messages" in flood.answers
    allowed = limits.burst + limits.flood
    assert stats["totals"]["limited"] == limits.flood + 1 and pictures == 2
    assert stats["totals"]["received"] - stats["clients"][0]["received"] == allowed + 1
    assert len(stats["clients"]) == 1


def test_a_flood_that_is_not_cut_off_starves_nobody(serve, fake_backend, cameras, stopped):
    """The limits taken away: what it does not read it drops, one request waits, the other client is served."""
    config = ServerConfig(port=0, session=SessionConfig(flood=10**9), limits=UNLIMITED)

    async def main():
        async with serve(config=config) as server, Client(server.url) as other:
            await other.render(cameras)
            flood = Flood(server.port)
            flood.start()
            await until(lambda: flooded(server))
            pictures = waiting = 0
            while (client := flooded(server))["received"] < 5000 or pictures < 20:
                await other.render(cameras)
                stopped.now += 1 / 60
                pictures += 1
                waiting = max(waiting, client["waiting"])
            flood.leave.set()
            await asyncio.to_thread(flood.join, HANG)
            return pictures, waiting, client

    pictures, waiting, client = asyncio.run(main())  # the flood has no end: who is starved by it waits in vain
    rated = SessionConfig().burst + SessionConfig().rate * pictures / 60
    assert client["accepted"] <= rated and client["limited"] >= client["received"] - rated  # others are not even parsed
    assert waiting <= 1


def test_half_open_connections_are_found_by_pings(serve, cameras, ahead):
    """Peers that vanished without a word: they neither read, nor answer, nor close."""

    async def main():
        ahead.lead()
        async with serve() as server:
            gone = [await raw(server) for _ in range(5)]
            for _, writer in gone:
                writer.write(frame(0x1, native(1).encode()))
            async with Client(server.url) as alive:  # answers pings, and stays
                await alive.render(cameras)
                await until(lambda: all(client["sent"] for client in server.stats()["clients"]))
                for seconds in (16.0, 8.5):  # a ping after 15 s, given up 7.5 s later; aiohttp rounds up
                    ahead.leap(seconds)
                    for _ in range(3):  # meanwhile its pong arrives
                        await alive.render(cameras)
                await until(lambda: len(server.stats()["clients"]) == 1)
                left = (await alive.render(cameras)).frame_id
            for _, writer in gone:
                writer.transport.abort()
            return left

    assert asyncio.run(main()) == 8


VICTIM = """
import socket, sys, time
s = socket.socket()
s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
s.connect(("127.0.0.1", int(sys.argv[1])))
s.sendall(bytes.fromhex(sys.argv[2])); s.recv(10)
s.sendall(bytes.fromhex(sys.argv[3]))
print("sent", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("moment", ["half a request sent", "its picture is drawn", "its picture is written"])
def test_a_client_killed_in_the_middle_of_a_frame(serve, fake_backend, cameras, moment):
    """SIGKILL on a client process; the picture goes nowhere, the next client is served."""
    backend = fake_backend(noise=moment == "its picture is written")
    size = [1536, 1536] if backend.noise else [64, 64]  # more than a socket takes of what nobody reads
    data = frame(0x1, native(1, size=size, quality=100).encode())
    data = data[:100] if moment.startswith("half") else data

    async def main():
        async with serve(backend) as server:
            happened = {
                "half a request sent": lambda: server.stats()["clients"],
                "its picture is drawn": lambda: backend.drawn,
                "its picture is written": lambda: server.stats()["stages"],
            }[moment]
            if moment == "its picture is drawn":
                backend.gate.clear()
            command = [sys.executable, "-S", "-c", VICTIM, str(server.port), UPGRADE.hex(), data.hex()]
            process = await asyncio.create_subprocess_exec(*command, stdout=subprocess.PIPE)
            await process.stdout.readline()
            await until(happened)
            process.send_signal(signal.SIGKILL)
            await process.wait()
            backend.gate.set()
            assert await still_serves(server, cameras)
            await until(lambda: not server.stats()["clients"])
            return server.stats()

    stats = asyncio.run(main())
    assert stats["clients"] == [] and stats["healthy"] and stats["totals"]["failed"] == 0
    assert len(backend.drawn) == (1 if moment.startswith("half") else 2)


def test_a_thousand_connections_leave_nothing_behind(serve, cameras):
    """In every manner of coming and going: no client, no task, no thread, no file stays."""

    async def visit(server, i):
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

    async def main():
        process = psutil.Process()
        async with serve(config=ServerConfig(port=0, limits=UNLIMITED)) as server:
            served = await still_serves(server, cameras)
            await until(lambda: not server.stats()["clients"])
            await asyncio.sleep(0)
            before = len(asyncio.all_tasks()), process.num_fds(), threading.active_count()
            done = i = 0
            while done < 1000 and i < 5000:
                done += await visit(server, i)
                i += 1
            await until(lambda: not server.stats()["clients"])
            with contextlib.suppress(TimeoutError):
                await until(lambda: len(asyncio.all_tasks()) <= before[0] and process.num_fds() <= before[1])
            after = len(asyncio.all_tasks()), process.num_fds(), threading.active_count()
            return done, before, after, served and await still_serves(server, cameras)

    done, before, after, alive = asyncio.run(main())
    assert done == 1000 and alive
    assert after[0] <= before[0] and after[1] <= before[1], (before, after)
    assert after[2] <= before[2] + 5  # the pools start their threads when they are needed first: 1 + 2 + 2


class Signed:
    """Each client's pictures carry its own colour (of its camera's fx) and the pattern of its frame_id."""

    def open(self) -> str:
        return "signed"

    def render(self, request) -> Rendered:
        time.sleep(0.001)
        camera = request.cameras[0]
        out = np.zeros((len(request.cameras), camera.height, camera.width, 4), np.uint8)
        for view, eye in enumerate(request.cameras):
            out[view, :, :32] = (round(eye.K[0, 0]), 40 + 100 * view, 0, 255)
            out[view, :, 32:] = (0, 0, (request.frame_id * 7) % 200 + 40, 255)
        return Rendered(out)

    def close(self) -> None: ...


async def watch(url, number, frames):
    """How many pictures came, each of them checked to be this client's own and the one its frame_id says."""
    K = np.diag([40.0 + 25 * number, 50, 1])
    K[:2, 2] = 32
    eyes = [Camera(np.array(EYE["viewmat"], float).reshape(4, 4), K, 64, 64)] * 2
    async with Client(url) as client:
        for frame_id in range(1, frames + 1):
            await client.send(eyes, quality=95)
            reply = (await client.receive()).reply
            for view, image in enumerate(reply.images()):
                expected = [40 + 25 * number, 40 + 100 * view, 0, 0, 0, frame_id * 7 % 200 + 40]
                found = [*image[32, 8], *image[32, 56]]
                assert reply.frame_id == frame_id and np.abs(np.subtract(found, expected)).max() <= 6, number
    return frames


def test_eight_clients_one_of_them_misbehaving(serve):
    """Seven get every one of their own pictures; the eighth does what it can to prevent that."""

    async def ill(server):
        for _ in range(10):
            reader, writer = await raw(server)
            kinds = [native(1), "{", native(5, quality=0)]
            writer.writelines(frame(0x1, text.encode()) for text in kinds)
            writer.write(frame(0x2, b"\0" * 1000) + b"\xff\xff")
            await all_of(reader)  # the last of them ended it
            writer.transport.abort()

    async def main():
        async with serve(Signed()) as server:
            *counts, _ = await asyncio.gather(*(watch(server.url, i, 40) for i in range(7)), ill(server))
            return counts, server.stats()["totals"]

    counts, totals = asyncio.run(main())
    assert counts == [40] * 7 and totals["malformed"] == 30


SERVER = """
import asyncio, logging, sys
sys.path.insert(0, sys.argv[1])
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.conftest import FakeBackend
from tests.net.wire import UNLIMITED
class Quick(FakeBackend):
    def render(self, request):
        self.drawn.clear()
        return super().render(request)
logging.disable()
server = Server(Quick(), ServerConfig(port=0, session=SessionConfig(rate=1e5), limits=UNLIMITED))
asyncio.run(server.run(lambda: print(server.port, flush=True)))
"""


async def visits(url, connections, frames):
    """Connections one after another by four users at once, ``frames`` pictures over all of them."""
    left = iter(range(connections))
    each = frames // connections

    async def user(http):
        got = 0
        for i in left:
            async with http.ws_connect(url) as ws:
                for frame_id in range(1, each + 1):
                    await ws.send_str(native(frame_id, ack=frame_id - 1))
                    got += (await ws.receive(timeout=HANG)).type == aiohttp.WSMsgType.BINARY
                if i % 3 == 0:
                    await ws.send_str("{")
        return got

    async with aiohttp.ClientSession() as http:
        return sum(await asyncio.gather(*(user(http) for _ in range(4))))


def test_memory_after_hundreds_of_connections_and_thousands_of_frames():
    """The server's resident memory within 3 % of what it was after a quarter of that, then an orderly end."""
    process = subprocess.Popen([sys.executable, "-c", SERVER, str(ROOT)], stdout=subprocess.PIPE, text=True)
    try:
        url = f"ws://127.0.0.1:{process.stdout.readline().strip()}/ws"
        memory = psutil.Process(process.pid)
        assert asyncio.run(visits(url, 100, 1000)) == 1000
        early, files = memory.memory_info().rss, memory.num_fds()
        assert asyncio.run(visits(url, 300, 3000)) == 3000
        gc.collect()
        late = memory.memory_info().rss
        assert late <= early * 1.03, f"{early / 1e6:.1f} MB after 100 connections, {late / 1e6:.1f} MB after 400"
        assert memory.num_fds() <= files + 2
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANG) == 0
        print(f"{early / 1e6:.1f} MB, then {late / 1e6:.1f} MB")
    finally:
        process.kill()
        process.communicate()


def test_requests_of_all_kinds_at_once(serve):
    """The forms of all clients, and several windows, on one server at the same time."""
    head = {"pos_x": 0, "pos_y": 1.6, "pos_z": 2, "rot_x": 0, "rot_y": 1, "rot_z": 0, "rot_w": 0}
    pair = {"cameras": [head | {"eye": "left"}, head | {"eye": "right"}], "smplx": {"root_pose": [0, 0, 0]}}
    single = {"camera": head | {"eye": "right"}, "smplx": {"root_pose": [0, 0, 0]}}

    async def ask(http, url, text, starts):
        async with http.ws_connect(url) as ws:
            for _ in range(10):
                await ws.send_str(text())
                assert (await ws.receive(timeout=HANG)).data.startswith(starts)
        return True

    async def main():
        ids = iter(range(1, 100))
        async with serve() as server, aiohttp.ClientSession() as http:
            return await asyncio.gather(
                ask(http, server.url, lambda: native(i := next(ids), ack=i - 1), b"VR"),
                ask(http, server.url + "?window=8", lambda: json.dumps(pair), b"VR"),
                ask(http, server.url + "?window=1&mirror=1", lambda: json.dumps(single), b"\1\xff\xd8"),
            )

    assert asyncio.run(main()) == [True] * 3
