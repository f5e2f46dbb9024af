"""Hostile and broken clients over real sockets on loopback. The server lives, the others are served."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import socket
import struct
from contextlib import asynccontextmanager, suppress

import aiohttp
import pytest

from glsplat.errors import ContextError, ContextLostError, FormatError, ProtocolError
from glsplat.net import local_loop
from glsplat.net.client import Client, request_message
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.wire import EYE, HANG, UNLIMITED, UPGRADE, all_of, frame, native, raw, still_serves, until

MALFORMED = [
    "{",
    '{"v": 1, "frame_id": "seven"}',
    '{"v":1,"frame_id":1,"t":NaN}',
    '{"v":1,"frame_id":1,"t":1e999}',
    '{"x":' + "[" * 30000 + "]" * 30000 + "}",
    native(1, pose={"root_pose": [1, 2]}),
    native(1, size=[100000, 100000]),
]


@pytest.mark.parametrize("text", MALFORMED)
def test_a_malformed_message_costs_that_message_only(serve, text):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_str(text)
            answer = json.loads((await ws.receive(timeout=HANG)).data)["error"]
            await ws.send_str(native(2))
            return answer, (await ws.receive(timeout=HANG)).data[:2]

    error, magic = asyncio.run(main())
    assert magic == b"VR"
    assert set(error) == {"code", "message", "frame_id"} and error["message"].isprintable()
    assert "Traceback" not in error["message"] and "/" not in error["message"].replace("/ws", "")


def test_binary_where_text_belongs(serve, cameras):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_bytes(b"\x00" * 100)
            error = json.loads((await ws.receive(timeout=HANG)).data)["error"]
            await ws.send_str(native(1))
            return error["code"], (await ws.receive(timeout=HANG)).type

    assert asyncio.run(main()) == ("binary", aiohttp.WSMsgType.BINARY)


def test_repeated_malformed_messages_end_the_connection(serve, cameras):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            for _ in range(20):
                await ws.send_str("{")
            texts = 0
            while (message := await ws.receive(timeout=HANG)).type == aiohttp.WSMsgType.TEXT:
                texts += 1
            return texts, message.data, await still_serves(server, cameras)

    texts, code, alive = asyncio.run(main())
    assert (texts, code, alive) == (9, 1008, True)


@pytest.mark.parametrize("size", [64 * 1024 + 1, 4 * 1024 * 1024])
def test_an_oversized_message_ends_the_connection(serve, cameras, size):
    async def main():
        async with serve() as server:
            async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
                try:
                    await ws.send_str(" " * size)
                    message = await ws.receive(timeout=HANG)
                    code = message.data if message.type == aiohttp.WSMsgType.CLOSE else None
                except ConnectionError:
                    code = None
            return code, await still_serves(server, cameras)

    code, alive = asyncio.run(main())
    assert code in (1009, None) and alive


def test_broken_websocket_frames(serve, cameras):
    bad = [
        frame(0x3, b"reserved opcode"),
        frame(0x1, b"\xff\xfe"),  # not UTF-8
        frame(0x9, b"x" * 200),  # a ping longer than 125
        b"\xff" * 64,
        struct.pack("!BBQ", 0x81, 0xFF, 2**62) + b"\0\0\0\0",  # announces 4 EiB
        b"".join(frame(0x1 if i == 0 else 0x0, b"[" * 30000, fin=False) for i in range(4)),  # endless fragments
        struct.pack("!BB", 0x81, 3) + b"abc",  # not masked
    ]

    async def main():
        async with serve() as server:
            for data in bad:
                reader, writer = await raw(server)
                writer.write(data)
                writer.write_eof()
                await all_of(reader)
                writer.close()
            await until(lambda: not server.stats()["clients"])
            return await still_serves(server, cameras)

    assert asyncio.run(main())


def test_repeated_and_falling_ids_are_never_drawn(serve, fake_backend):
    backend = fake_backend()

    async def main():
        async with serve(backend) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_str(native(5))
            await ws.receive(timeout=HANG)
            for frame_id in (5, 4, 1, 0, 6):
                await ws.send_str(native(frame_id))
            await ws.receive(timeout=HANG)
            return server.stats()["totals"]

    totals = asyncio.run(main())
    assert [request.frame_id for request in backend.drawn] == [5, 6] and totals["stale"] == 4


def test_a_burst_of_requests_draws_only_a_few(serve, fake_backend, cameras, stopped):
    backend, config = fake_backend(), ServerConfig(port=0, limits=UNLIMITED)

    async def main():
        async with serve(backend, config) as server, aiohttp.ClientSession() as http:
            async with http.ws_connect(server.url) as ws, Client(server.url) as other:
                for i in range(1, 501):
                    await ws.send_str(native(i))
                await until(lambda: server.stats()["clients"][0]["received"] == 500)
                for _ in range(2):
                    while (await ws.receive(timeout=HANG)).type != aiohttp.WSMsgType.BINARY:
                        pass
                for _ in range(5):  # takes turns with the first
                    await other.render(cameras)
                return server.stats()["clients"][0]

    client, burst = asyncio.run(main()), SessionConfig().burst
    viewers = [request.viewer for request in backend.drawn]
    assert viewers.count(1) == 2 and viewers.count(2) == 5  # the window, as nothing is acknowledged
    assert client["received"] == 500 and client["limited"] == 500 - burst
    # the newest of the burst, unless the second picture was that one
    assert client["waiting"] == (max(r.frame_id for r in backend.drawn if r.viewer == 1) < burst)


@asynccontextmanager
async def stuck_client(server, other, cameras):
    """A client that reads nothing; a function that has it ask for one more picture, while another client is served."""
    stuck = socket.socket()
    stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stuck.setblocking(False)
    loop = asyncio.get_running_loop()
    await loop.sock_connect(stuck, ("127.0.0.1", server.port))
    await loop.sock_sendall(stuck, UPGRADE.replace(b"/ws", b"/ws?window=8"))
    await until(lambda: len(server.stats()["clients"]) == 2)
    ids = itertools.count(1)

    async def ask():
        text = json.dumps({"v": 1, "frame_id": next(ids), "eyes": [EYE], "size": [1024, 1024], "quality": 100})
        await loop.sock_sendall(stuck, frame(0x1, text.encode()))
        await other.render(cameras)

    yield ask
    stuck.close()


def test_nobody_waits_for_a_client_that_stops_reading(serve, fake_backend, cameras):
    """Nor do its pictures pile up in the server."""
    backend = fake_backend(noise=True)
    config = ServerConfig(port=0, write_timeout=1e6, heartbeat=1e6, session=SessionConfig(rate=1e4, burst=1e4))

    async def main():
        async with serve(backend, config) as server, Client(server.url) as other:
            async with stuck_client(server, other, cameras) as ask:
                drawn = []
                while drawn[-10:].count(drawn[-1] if drawn else 0) < 10 and len(drawn) < 100:
                    await ask()
                    drawn.append(sum(request.viewer == 2 for request in backend.drawn))
            await until(lambda: len(server.stats()["clients"]) == 1)
            return drawn

    assert len(asyncio.run(main())) < 100  # ten more requests brought no more pictures


def test_a_client_that_stops_reading_is_cut_off(serve, fake_backend, cameras):
    config = ServerConfig(port=0, write_timeout=0.2, heartbeat=1e6, session=SessionConfig(rate=1e4, burst=1e4))

    async def main():
        async with serve(fake_backend(noise=True), config) as server, Client(server.url) as other:
            async with stuck_client(server, other, cameras) as ask:
                async with asyncio.timeout(HANG):
                    with suppress(ConnectionError):  # it is cut off, and still counted for a moment
                        while len(server.stats()["clients"]) == 2:
                            await ask()
                await until(lambda: len(server.stats()["clients"]) == 1)
            return (await other.render(cameras)).frame_id

    assert asyncio.run(main()) > 1


def test_an_error_while_drawing_reaches_only_its_client(serve, fake_backend, cameras, caplog):
    def fail(request):
        if request.cameras[0].width == 32:
            return FormatError("/secret/path/avatar.glb: broken")
        return RuntimeError("GL_OUT_OF_MEMORY in /secret/path") if request.cameras[0].width == 16 else None

    async def main():
        async with serve(fake_backend(fail=fail)) as server:
            async with Client(server.url) as good, aiohttp.ClientSession() as http:
                async with http.ws_connect(server.url) as bad:
                    answers = []
                    for i, width in enumerate((32, 16, 64), 1):
                        await bad.send_str(native(i, size=[width, 64]))
                        await good.render(cameras)
                        answers.append(await bad.receive(timeout=HANG))
                    return answers, server.render_loop.healthy

    (one, two, three), healthy = asyncio.run(main())
    for answer, frame_id in ((one, 1), (two, 2)):
        assert json.loads(answer.data)["error"] == {
            "code": "render",
            "message": "the picture could not be drawn",
            "frame_id": frame_id,
        }
    assert three.type == aiohttp.WSMsgType.BINARY and healthy
    assert "GL_OUT_OF_MEMORY" in caplog.text  # in the server's log, not on the wire


def test_a_renderer_that_always_fails_is_not_healthy(serve, fake_backend, cameras):
    async def main():
        async with serve(fake_backend(fail=lambda request: RuntimeError("lost"))) as server:
            async with Client(server.url) as client, aiohttp.ClientSession() as http:
                for _ in range(3):
                    with pytest.raises(ProtocolError, match="could not be drawn"):
                        await client.render(cameras)
                async with http.get(f"http://127.0.0.1:{server.port}/healthz") as response:
                    return response.status

    assert asyncio.run(main()) == 503


def test_a_renderer_that_hangs_is_not_healthy(serve, fake_backend, cameras, stopped):
    backend = fake_backend()
    backend.gate.clear()

    async def main():
        async with serve(backend) as server, Client(server.url) as client:
            await client.send(cameras)
            await until(lambda: backend.drawn)
            healthy = []
            for seconds in (0.0, 9.9, 0.2):
                stopped.now += seconds
                healthy.append(server.render_loop.healthy)
            backend.gate.set()
            await client.receive()
            return *healthy, server.render_loop.healthy

    assert asyncio.run(main()) == (True, True, False, True)


def test_the_client_reports_a_server_that_goes_away(cameras):
    async def main():
        with pytest.raises(ProtocolError, match=r"no server at ws://127\.0\.0\.1:9/ws: start one with `glsplat serve`"):
            await Client("ws://127.0.0.1:9/ws", timeout=HANG).connect()

    asyncio.run(main())
    assert request_message(1)["v"] == 1


@pytest.mark.parametrize("kind", ["comes back", "no new one"])
def test_a_lost_context(fake_backend, cameras, kind, caplog, monkeypatch):
    """It is made anew under the clients' feet; where that fails the server stops in order, with a message."""
    monkeypatch.setattr(local_loop, "_PAUSES", (0.0, 0.01, 0.02))

    class Losing(fake_backend):
        opens = 0

        def open(self):
            self.opens += 1
            if kind == "no new one" and self.opens > 1:
                raise ContextError("no EGL device any more")
            return f"{super().open()} {self.opens}"

    def lost(request):
        return ContextLostError("lost") if request.frame_id == 2 else None

    backend = Losing(fail=lost)
    server = Server(backend, ServerConfig(port=0))
    drivers, errors = [], []

    async def watch():
        async with Client(server.url) as client:
            for _ in range(12):
                try:
                    drivers.append((await client.render(cameras)).info["driver"])
                except ProtocolError as error:
                    errors.append(str(error))
                    if error.code == "closed":
                        return
        if kind == "comes back":
            os.kill(os.getpid(), signal.SIGTERM)

    async def main():
        tasks = []
        await server.run(lambda: tasks.append(asyncio.create_task(watch())))

    if kind == "comes back":
        asyncio.run(main())
        assert drivers == ["numpy <fake> 1"] + ["numpy <fake> 2"] * 10 and errors == ["the picture could not be drawn"]
    else:
        with pytest.raises(ContextError, match="no EGL device"):
            asyncio.run(main())
        assert drivers == ["numpy <fake> 1"] and errors[-1].endswith("closed the connection (1001)")
        assert backend.opens == 4  # it was tried three times
    assert backend.closed and len(backend.threads) == 1
    assert "Traceback" not in caplog.text
