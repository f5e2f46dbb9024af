"""What the log says of strangers: a line, and nothing of what they sent."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket

import pytest

from glsplat.extras.operations import feature
from glsplat.net.guard.limits import Limits
from glsplat.net.server import ServerConfig
from tests.net.wire import EYE, UPGRADE, ask, frame, get, native, status, still_serves, until


@pytest.fixture
def lines(caplog):
    caplog.set_level(logging.DEBUG)
    return lambda: [
        record.getMessage() + (record.exc_text or "") for record in caplog.records if record.levelno >= logging.INFO
    ]


SECRET = "SECRETSECRETSECRET"
STRANGE = {
    "a token without the subprotocol": UPGRADE.replace(
        b"Sec-WebSocket-Version", f"Sec-WebSocket-Protocol: token.{SECRET}\r\nSec-WebSocket-Version".encode()
    ),
    "subprotocols of 6 kB": UPGRADE.replace(
        b"Sec-WebSocket-Version", f"Sec-WebSocket-Protocol: {SECRET * 340}\r\nSec-WebSocket-Version".encode()
    ),
    "no HTTP": f"\x00\x01{SECRET}\r\n\r\n".encode(),
    "a header without a name": f"GET / HTTP/1.1\r\n: {SECRET}\r\n\r\n".encode(),
    "a header of 9 kB": f"GET / HTTP/1.1\r\nHost: a\r\nX: {SECRET * 500}\r\n\r\n".encode(),
    "another method": f"{SECRET} / HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    "an address that is none": f"GET http://[{SECRET}/ HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    "an address with a name that is none": f"GET http://xn--a.{SECRET}/ HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    "two lengths": f"POST /{SECRET} HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nContent-Length: 4\r\n\r\nabc".encode(),
    "an Upgrade that is no text": UPGRADE.replace(b"Upgrade: websocket", b"Upgrade: webs\xefcket"),
    "a version that is no text": UPGRADE.replace(b"Version: 13", b"Version: 13\x80"),
    "a key that is no text": UPGRADE.replace(b"dGhlIHNhbXBsZSBub25jZQ==", b"dGhlIHNhbXBsZSBub\x8a5jZQ=="),
    "a key beyond ASCII": UPGRADE.replace(b"dGhlIHNhbXBsZSBub25jZQ==", b"dGhlIHNhbXBsZSBub2\xc3\xa9ZQ=="),
    "a key that is none": UPGRADE.replace(b"dGhlIHNhbXBsZSBub25jZQ==", SECRET.encode()),
}


@pytest.mark.parametrize("kind", STRANGE)
async def test_what_strangers_send_is_not_logged(serve, lines, kind):
    async with serve(config=ServerConfig(port=0, limits=Limits(visits_burst=1e9))) as server:
        for _ in range(5):
            answer = await ask(server.port, STRANGE[kind])
            assert answer == "" or 400 <= status(answer) < 500
    assert len(lines()) <= 2 and all(len(line) < 120 and "\n" not in line for line in lines())
    assert SECRET[:6] not in "".join(lines())


async def test_a_reset_after_the_handshake_is_no_fault(serve, cameras, lines):
    async with serve(config=ServerConfig(port=0, limits=Limits(visits_burst=1e9))) as server:
        for i in range(24):
            peer = socket.create_connection(("127.0.0.1", server.port))
            peer.sendall(UPGRADE + (frame(0x1, native(1).encode()) if i % 2 else b""))
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            if i % 3:  # else it is gone before the server reads what it asked
                await asyncio.sleep(0.001 * (i % 4))
            peer.close()
        await until(lambda: not server.stats()["clients"])
        assert await still_serves(server, cameras)
    assert len(lines()) <= 2 and not any("failed in the server" in line for line in lines())


async def test_a_fault_of_the_server_is_one_line_with_its_place(serve, lines, monkeypatch):
    async with serve() as server:
        monkeypatch.setattr(feature, "page_html", lambda *_: {}[SECRET])
        assert [status(await ask(server.port, get("/"))) for _ in range(5)] == [500] * 5
    assert len(lines()) == 1 and re.search(r"KeyError at test_quiet_log\.py:\d+$", lines()[0])


async def test_clients_that_read_nothing_are_one_line(serve, fake_backend, lines):
    config = ServerConfig(port=0, write_timeout=0.1, heartbeat=1e6)
    large = {"eyes": [{**EYE, "K": [500, 500, 512, 512]}] * 2, "size": [1024, 1024], "quality": 100}
    asked = [frame(0x1, native(number, **large).replace('"ack": 0, ', "").encode()) for number in range(1, 9)]
    async with serve(fake_backend(noise=True), config) as server:
        for _ in range(2):
            peer = socket.socket()
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            peer.setblocking(False)
            peer.connect_ex(("127.0.0.1", server.port))
            await asyncio.get_running_loop().sock_sendall(peer, UPGRADE + asked[0])
            await until(lambda: server.stats()["clients"])
            with contextlib.suppress(ConnectionError):
                for text in asked[1:]:
                    await asyncio.get_running_loop().sock_sendall(peer, text)
                    await asyncio.sleep(0.05)
            await until(lambda: not server.stats()["clients"])
            peer.close()
    assert [line for line in lines() if "read" in line] == ["a client does not read its pictures; cut off"]
