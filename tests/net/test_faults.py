"""Hostile and broken clients over real sockets on loopback. The server lives, the others are served."""

from __future__ import annotations

import asyncio
import json
import socket
import struct

import aiohttp
import pytest

from glsplat.errors import ContextError, ContextLostError, FormatError, ProtocolError
from glsplat.net import render_loop
from glsplat.net.client import Client, request_message
from glsplat.net.served_scene import server_of
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from tests.net.conftest import FakeBackend
from tests.net.wire import EYE, HANG, UPGRADE, all_of, frame, native, raw, still_serves, until

MALFORMED = [
    "{",
    '{"v": 1, "frame_id": "seven"}',
    '{"v":1,"frame_id":1,"t":NaN}',
    '{"v":1,"frame_id":1,"t":1e999}',
    '{"x":' + "[" * 30000 + "]" * 30000 + "}",
    native(1, pose={"root_pose": [1, 2]}),
    native(1, size=[100000, 100000]),
]


async def test_a_malformed_message_costs_that_message_only(serve):
    async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        for data in [*MALFORMED, bytes(100)]:
            await (ws.send_bytes(data) if isinstance(data, bytes) else ws.send_str(data))
            error = json.loads((await ws.receive(timeout=HANG)).data)["error"]
            assert set(error) == {"code", "message", "frame_id"} and error["message"].isprintable()
            assert "Traceback" not in error["message"] and "/" not in error["message"].replace("/ws", "")
        assert error["code"] == "binary"
        await ws.send_str(native(2))
        assert (await ws.receive(timeout=HANG)).data[:2] == b"VR"


async def test_repeated_malformed_messages_end_the_connection(serve, cameras):
    async with serve() as server, aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
        for _ in range(20):
            await ws.send_str("{")
        answers = [await ws.receive(timeout=HANG) for _ in range(10)]
        assert [one.type for one in answers] == [aiohttp.WSMsgType.TEXT] * 9 + [aiohttp.WSMsgType.CLOSE]
        assert answers[-1].data == 1008 and await still_serves(server, cameras)


@pytest.mark.parametrize("size", [64 * 1024 + 1, 4 * 1024 * 1024])
async def test_an_oversized_message_ends_the_connection(serve, cameras, size):
    async with serve() as server:
        async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as ws:
            try:
                await ws.send_str(" " * size)
                message = await ws.receive(timeout=HANG)
                code = message.data if message.type == aiohttp.WSMsgType.CLOSE else None
            except ConnectionError:
                code = None
        alive = await still_serves(server, cameras)
    assert code in (1009, None) and alive


async def test_broken_websocket_frames(serve, cameras):
    bad = [
        frame(0x3, b"reserved opcode"),
        frame(0x1, b"\xff\xfe"),  # not UTF-8
        frame(0x9, b"x" * 200),  # a ping longer than 125
        b"\xff" * 64,
        struct.pack("!BBQ", 0x81, 0xFF, 2**62) + b"\0\0\0\0",  # announces 4 EiB
        b"".join(frame(0x1 if i == 0 else 0x0, b"[" * 30000, fin=False) for i in range(4)),  # endless fragments
        struct.pack("!BB", 0x81, 3) + b"abc",  # not masked
    ]
    async with serve() as server:
        for data in bad:
            reader, writer = await raw(server)
            writer.write(data)
            writer.write_eof()
            await all_of(reader)
            writer.close()
        await until(lambda: not server.stats()["clients"])
        assert await still_serves(server, cameras)


async def test_nobody_waits_for_a_client_that_stops_reading(serve, fake_backend, cameras):
    """Nor do its pictures pile up in the server."""
    backend, loop = fake_backend(noise=True), asyncio.get_running_loop()
    config = ServerConfig(port=0, write_timeout=1e6, heartbeat=1e6, session=SessionConfig(rate=1e4, burst=1e4))
    async with serve(backend, config) as server, Client(server.url) as other:
        with socket.socket() as stuck:
            stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stuck.setblocking(False)
            await loop.sock_connect(stuck, ("127.0.0.1", server.port))
            await loop.sock_sendall(stuck, UPGRADE.replace(b"/ws", b"/ws?window=8"))
            await until(lambda: len(server.stats()["clients"]) == 2)
            drawn = []
            while len(drawn) < 10 or drawn[-10] != drawn[-1]:  # until ten more requests bring no more pictures
                text = {"v": 1, "frame_id": len(drawn) + 1, "eyes": [EYE], "size": [1024, 1024], "quality": 100}
                await loop.sock_sendall(stuck, frame(0x1, json.dumps(text).encode()))
                await other.render(cameras)
                drawn.append(sum(request.viewer == 2 for request in backend.drawn))
                assert len(drawn) < 100
        await until(lambda: len(server.stats()["clients"]) == 1)


async def test_an_error_while_drawing_reaches_only_its_client(serve, fake_backend, cameras, caplog):
    errors = {32: FormatError("/secret/avatar.glb: broken"), 16: RuntimeError("GL_OUT_OF_MEMORY in /secret")}
    told = {"code": "render", "message": "the picture could not be drawn"}
    backend = fake_backend(fail=lambda request: errors.get(request.cameras[0].width))
    async with serve(backend) as server, Client(server.url) as good, aiohttp.ClientSession() as http:
        async with http.ws_connect(server.url) as bad:
            for i, width in enumerate((32, 16), 1):
                await bad.send_str(native(i, size=[width, 64]))
                await good.render(cameras)
                assert json.loads((await bad.receive(timeout=HANG)).data)["error"] == told | {"frame_id": i}
            await bad.send_str(native(3))
            assert (await bad.receive(timeout=HANG)).data[:2] == b"VR" and server.drawer.healthy
    assert "GL_OUT_OF_MEMORY" in caplog.text  # in the server's log, not on the wire


async def test_a_renderer_that_always_fails_is_not_healthy(serve, fake_backend, cameras):
    async with serve(fake_backend(fail=lambda request: RuntimeError("lost"))) as server:
        async with Client(server.url) as client, aiohttp.ClientSession() as http:
            for _ in range(3):
                with pytest.raises(ProtocolError, match="could not be drawn"):
                    await client.render(cameras)
            async with http.get(f"http://127.0.0.1:{server.port}/healthz") as response:
                assert response.status == 503


async def test_a_renderer_that_hangs_is_not_healthy(serve, fake_backend, cameras, stopped):
    backend = fake_backend()
    backend.gate.clear()
    async with serve(backend) as server, Client(server.url) as client:
        await client.send(cameras)
        await until(lambda: backend.drawn)
        healthy = []
        for seconds in (0.0, 9.9, 0.2):
            stopped.now += seconds
            healthy.append(server.drawer.healthy)
        backend.gate.set()
        await client.receive()
        assert (*healthy, server.drawer.healthy) == (True, True, False, True)


async def test_the_client_reports_a_server_that_goes_away(cameras):
    with pytest.raises(ProtocolError, match=r"no server at ws://127\.0\.0\.1:9/ws: start one with `glsplat serve`"):
        await Client("ws://127.0.0.1:9/ws", timeout=HANG).connect()
    assert request_message(1)["v"] == 1


class Losing(FakeBackend):
    """Loses its context at the second picture; ``opens`` counts how often it was made."""

    opens, last = 0, 9

    def open(self):
        self.opens += 1
        if self.opens > self.last:
            raise ContextError("no EGL device any more")
        return f"{super().open()} {self.opens}"


def losing(monkeypatch, last):
    monkeypatch.setattr(render_loop, "_REVIVE_PAUSES_S", (0.0, 0.01, 0.02))
    backend = Losing(fail=lambda request: ContextLostError("lost") if request.frame_id == 2 else None)
    backend.last = last
    return backend


async def test_a_lost_context_is_made_anew_under_the_clients_feet(serve, cameras, monkeypatch, caplog):
    backend = losing(monkeypatch, 9)
    async with serve(backend) as server, Client(server.url) as client:
        assert (await client.render(cameras)).info["driver"] == "numpy <fake> 1"
        with pytest.raises(ProtocolError, match="the picture could not be drawn"):
            await client.render(cameras)
        assert (await client.render(cameras)).info["driver"] == "numpy <fake> 2"
    assert backend.closed and len(backend.threads) == 1 and "Traceback" not in caplog.text


async def test_without_a_new_context_the_server_stops_with_a_message(cameras, monkeypatch, caplog):
    backend = losing(monkeypatch, 1)
    server, ready = server_of(backend, ServerConfig(port=0)), asyncio.Event()
    running = asyncio.create_task(server.run(ready.set))
    await ready.wait()
    async with Client(server.url) as client:
        with pytest.raises(ProtocolError, match=r"closed the connection \(1001\)$"):
            for _ in range(12):
                try:
                    await client.render(cameras)
                except ProtocolError as error:
                    if error.code == "closed":
                        raise
    with pytest.raises(ContextError, match="no EGL device"):
        await running
    assert backend.opens == 4 and backend.closed  # it was tried three times
    assert "Traceback" not in caplog.text
