"""Hostile and broken clients over real sockets on loopback. The server lives, the others are served."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import struct
import time

import aiohttp
import pytest

from glsplat.errors import ContextError, ContextLostError, FormatError, ProtocolError
from glsplat.net.client import Client, request_message
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.wire import EYE, frame, native, raw, still_serves

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
            answer = json.loads((await ws.receive(timeout=2)).data)["error"]
            await ws.send_str(native(2))
            return answer, (await ws.receive(timeout=2)).data[:2]

    error, magic = asyncio.run(main())
    assert magic == b"VR"
    assert set(error) == {"code", "message", "frame_id"} and error["message"].isprintable()
    assert "Traceback" not in error["message"] and "/" not in error["message"].replace("/ws", "")


def test_binary_where_text_belongs(serve, cameras):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            await ws.send_bytes(b"\x00" * 100)
            error = json.loads((await ws.receive(timeout=2)).data)["error"]
            await ws.send_str(native(1))
            return error["code"], (await ws.receive(timeout=2)).type

    assert asyncio.run(main()) == ("binary", aiohttp.WSMsgType.BINARY)


def test_repeated_malformed_messages_end_the_connection(serve, cameras):
    async def main():
        async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            for _ in range(20):
                await ws.send_str("{")
            texts = 0
            while (message := await ws.receive(timeout=2)).type == aiohttp.WSMsgType.TEXT:
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
                    message = await ws.receive(timeout=2)
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
                try:
                    await asyncio.wait_for(reader.read(), 5)
                except ConnectionError:
                    pass
                writer.close()
            return server.stats()["clients"], await still_serves(server, cameras)

    clients, alive = asyncio.run(main())
    assert alive and clients == []


def test_repeated_and_falling_ids_are_never_drawn(serve, fake_backend):
    backend = fake_backend()

    async def main():
        async with serve(backend) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            for frame_id in (5, 5, 4, 1, 0, 6):
                await ws.send_str(native(frame_id))
                await asyncio.sleep(0.03)
            return server.stats()["totals"]

    totals = asyncio.run(main())
    ids = [request.frame_id for request in backend.drawn]
    assert ids == sorted(set(ids)) and set(ids) <= {5, 6} and totals["stale"] == 4


def test_a_burst_of_requests_draws_only_a_few(serve, fake_backend):
    backend = fake_backend(delay=0.01)

    async def main():
        async with serve(backend) as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            for i in range(1, 501):
                await ws.send_str(native(i))
            for _ in range(500):
                await asyncio.sleep(0.02)
                if server.stats()["totals"]["received"] == 500:
                    break
            await asyncio.sleep(0.1)
            return server.stats()["totals"], server.stats()["clients"][0]

    totals, client = asyncio.run(main())
    assert len(backend.drawn) <= 2 + 1  # the window, as nothing is acknowledged
    assert totals["received"] == 500 and totals["limited"] > 300
    assert client["waiting"] <= 1


def test_a_client_that_stops_reading_is_cut_off(serve, fake_backend, cameras):
    """Its pictures do not pile up in the server, and others do not wait for it."""
    backend = fake_backend(noise=True)
    config = ServerConfig(port=0, write_timeout=1.5, session=SessionConfig(rate=1e4, burst=1e4))

    async def main():
        async with serve(backend, config) as server:
            stuck = socket.create_connection(("127.0.0.1", server.port))
            stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stuck.setblocking(False)
            loop = asyncio.get_running_loop()
            await loop.sock_sendall(
                stuck,
                b"GET /ws?window=8 HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
            )
            async with Client(server.url) as other:
                slowest = 0.0
                for i in range(1, 200):
                    text = json.dumps({"v": 1, "frame_id": i, "eyes": [EYE], "size": [1024, 1024], "quality": 100})
                    try:
                        await loop.sock_sendall(stuck, frame(0x1, text.encode()))
                    except ConnectionError:
                        break
                    start = time.perf_counter()
                    await other.render(cameras)
                    slowest = max(slowest, time.perf_counter() - start)
                    if len(server.stats()["clients"]) == 1:
                        break
                    await asyncio.sleep(0.02)
                clients = len(server.stats()["clients"])
            stuck.close()
            return clients, slowest

    clients, slowest = asyncio.run(main())
    assert clients == 1  # the other one
    assert slowest < 1.4  # below the write time-out: it never waited for the stuck one


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
                        answers.append(await bad.receive(timeout=2))
                    return answers, server.pump.healthy

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


def test_a_renderer_that_hangs_is_not_healthy(serve, fake_backend, cameras, monkeypatch):
    monkeypatch.setattr("glsplat.net.pump._STUCK", 0.1)

    async def main():
        async with serve(fake_backend(delay=0.4)) as server, Client(server.url) as client:
            await client.send(cameras)
            await asyncio.sleep(0.05)
            before = server.pump.healthy
            await asyncio.sleep(0.2)
            during = server.pump.healthy
            await client.receive()
            return before, during, server.pump.healthy

    assert asyncio.run(main()) == (True, False, True)


def test_slow_handshakes_and_silence_are_ended(serve, fake_backend):
    config = ServerConfig(port=0, session=SessionConfig(handshake=0.3, idle=0.4))

    async def until_closed(reader, limit):
        start = time.perf_counter()
        await asyncio.wait_for(reader.read(), limit)
        return time.perf_counter() - start

    async def main():
        async with serve(fake_backend(), config) as server:
            silent, silent_writer = await asyncio.open_connection("127.0.0.1", server.port)
            slow, slow_writer = await asyncio.open_connection("127.0.0.1", server.port)
            slow_writer.write(b"GET /ws HTTP/1.1\r\nHost: x\r\nX-A: ")  # never ends its headers
            mute, mute_writer = await raw(server)
            idle, idle_writer = await raw(server)
            idle_writer.write(frame(0x1, native(1).encode()))
            times = await asyncio.gather(*(until_closed(r, 4) for r in (silent, slow, mute, idle)))
            for writer in (silent_writer, slow_writer, mute_writer, idle_writer):
                writer.close()
            return times

    assert max(asyncio.run(main())) < 4


def test_the_client_reports_a_server_that_goes_away(cameras):
    async def main():
        with pytest.raises(ProtocolError, match=r"no server at ws://127\.0\.0\.1:9/ws: start one with `glsplat serve`"):
            await Client("ws://127.0.0.1:9/ws", timeout=2).connect()

    asyncio.run(main())
    assert request_message(1)["v"] == 1


@pytest.mark.parametrize("kind", ["comes back", "no new one"])
def test_a_lost_context(fake_backend, cameras, kind, caplog):
    """It is made anew under the clients' feet; where that fails the server stops in order, with a message."""

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
        start = time.perf_counter()
        with pytest.raises(ContextError, match="no EGL device"):
            asyncio.run(main())
        assert time.perf_counter() - start < 10
        assert drivers == ["numpy <fake> 1"] and errors[-1].endswith("closed the connection (1001)")
        assert backend.opens == 4  # it was tried three times
    assert backend.closed and len(backend.threads) == 1
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize("reads", [True, False])
def test_pings_do_not_keep_a_connection_without_requests(serve, fake_backend, reads):
    """A client that only pings, reading the pongs or not; in the latter case the server gets stuck on writing them."""
    config = ServerConfig(port=0, write_timeout=0.3, session=SessionConfig(handshake=0.5))
    pings = frame(0x9, b"x" * 125) * (1 if reads else 500)

    async def main():
        async with serve(fake_backend(), config) as server:
            reader, writer = await raw(server)
            start = time.perf_counter()
            while server.stats()["clients"] and time.perf_counter() - start < 4:
                writer.write(pings)
                if reads:
                    await reader.read(65536)
                else:
                    with contextlib.suppress(TimeoutError, ConnectionError):
                        await asyncio.wait_for(writer.drain(), 0.02)
                await asyncio.sleep(0.01)
            writer.transport.abort()
            return time.perf_counter() - start

    assert asyncio.run(main()) < 2


def test_answering_pings_is_not_a_message(serve, fake_backend):
    config = ServerConfig(port=0, heartbeat=0.2, session=SessionConfig(handshake=0.5, idle=0.5))

    async def main():
        async with serve(fake_backend(), config) as server, aiohttp.ClientSession() as http:
            async with http.ws_connect(server.url) as ws:
                await ws.send_str(native(1))
                return [(await ws.receive(timeout=3)).type for _ in range(3)], ws.close_code

    kinds, code = asyncio.run(main())
    assert kinds == [aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.CLOSE] and code == 1008
