"""Connections that are no clients: each is counted until its socket is closed, whatever its peer does."""

from __future__ import annotations

import asyncio
import socket
from functools import partial

import numpy as np
import pytest

from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.guard.limits import Limits
from glsplat.net.options import ServerConfig
from glsplat.net.server import Server
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.net.clocks import Ahead
from tests.net.conftest import FakeBackend, Serve
from tests.net.wire import EYE, UPGRADE, all_of, ask, frame, get, native, status, still_serves, until

TOKEN = "0123456789abcdef-token"
RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))
OFFERED = (AvatarInfo(name="ann", skeleton=RIG, height=1.7),)
LARGE = {"eyes": [{**EYE, "K": [500, 500, 512, 512]}] * 2, "size": [1024, 1024], "quality": 100}
WAITING = Limits(waiting=4, visits_burst=1e9)


def upgrade(query: str = "", more: str = "") -> bytes:
    return UPGRADE.replace(b"/ws", b"/ws" + query.encode()).replace(
        b"Version: 13\r\n", f"Version: 13\r\n{more}".encode()
    )


REFUSED = {
    "an avatar that is not offered": (400, upgrade("?avatar=nobody")),
    "an option without a meaning": (400, upgrade("?window=x")),
    "another subprotocol": (400, upgrade(more="Sec-WebSocket-Protocol: other\r\n")),
    "no handshake": (400, get("/ws").replace("close", "keep-alive").encode()),
    "another version": (400, upgrade().replace(b"Version: 13", b"Version: 12")),
    "a room that there is not": (404, upgrade("?room=nowhere&name=ann")),
    "a name that is taken": (409, upgrade("?room=lab&name=ann")),
    "a room that is full": (503, upgrade("?room=lab&name=bob")),
    "no token": (401, upgrade().replace(b"Authorization: Bearer " + TOKEN.encode(), b"X: y")),
    "another page": (403, upgrade(more="Origin: http://evil.example\r\n")),
    "no such address": (404, get("/nosuch").replace("close", "keep-alive").encode()),
    "no such method": (405, b"OPTIONS /ws HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"),
    "no such method of a page": (405, b"POST /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\n\r\n"),
    "an expectation": (417, get("/vr/").replace("Connection: close", "Expect: a miracle").encode()),
    "another host": (421, get("/healthz", "evil.example").replace("close", "keep-alive").encode()),
    "too many clients of the address": (429, upgrade()),
    "too many clients": (503, upgrade()),
}


@pytest.mark.extra(name="rooms")
@pytest.mark.parametrize("kind", REFUSED)
async def test_a_refusal_ends_its_connection(serve: Serve, kind: str) -> None:
    """None of them is a keep-alive connection that nobody counts."""
    wanted, text = REFUSED[kind]
    text = text.replace(b"Host: 127.0.0.1\r\n", f"Host: 127.0.0.1\r\nAuthorization: Bearer {TOKEN}\r\n".encode())
    if kind == "no token":
        text = text.replace(TOKEN.encode(), b"wrong-" + TOKEN.encode())
    full, crowd = kind == "too many clients", kind == "too many clients of the address"
    limits = Limits(visits_burst=1e9, per_address=1 if crowd else 8)
    more = {"limits": limits, "max_clients": 1 if full else 8, "rooms": {"lab": 1}}
    config = ServerConfig(port=0, access=Access(token=TOKEN), **more)
    inside = partial(Client, token=TOKEN, room="lab", name="ann")
    async with serve(config=config, offered=OFFERED) as server, inside(server.url):
        source = "127.0.0.1" if crowd else "127.0.0.2"
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port, local_addr=(source, 0))
        writer.write(text + get("/healthz").encode())  # which a connection that goes on would answer
        answer = (await all_of(reader)).decode("latin-1")
        await until(lambda: server.gate.status()["waiting"] == 0)
        writer.transport.abort()
        held = sum(one.clients for one in server.gate.addresses._table.values())
        assert answer.count("HTTP/1.1 ") == 1 and "Connection: close" in answer
        assert (status(answer), len(server.stats()["clients"]), held) == (wanted, 1, 1)


def small_peer(server: Server) -> socket.socket:
    """A connection that takes next to nothing."""
    peer = socket.socket()
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    peer.setblocking(False)
    peer.connect_ex(("127.0.0.1", server.port))
    return peer


def open_ones(transports: list[asyncio.Transport]) -> int:
    return sum(one.get_extra_info("socket").fileno() >= 0 for one in transports)


async def test_clients_that_leave_and_take_nothing_are_counted_again(serve: Serve, cameras: object) -> None:
    """They say goodbye with pictures unread: the socket stays open until the pictures are taken, or room is needed."""
    config = ServerConfig(port=0, limits=WAITING, max_clients=2)
    async with serve(FakeBackend(noise=True), config) as server:
        loop = asyncio.get_running_loop()
        peers, transports = [], []
        for _ in range(8):
            peers.append(peer := small_peer(server))
            await loop.sock_sendall(peer, UPGRADE + frame(0x1, native(1, **LARGE).encode()))
            await until(lambda: server._conversations)
            (transport,) = (talk._request.transport for talk in server._conversations.values())
            transports.append(transport)
            await until(lambda: transports[-1].get_write_buffer_size() > 0)
            await loop.sock_sendall(peer, frame(0x8, b"\x03\xe8"))  # it is going away
            await until(lambda: not server.clients)
        await asyncio.sleep(0)
        assert 1 <= server.gate.status()["waiting"] <= 4 and open_ones(transports) <= 4
        assert await still_serves(server, cameras)
        for peer in peers:
            peer.close()


async def test_idle_connections_with_something_unsent_can_be_closed(serve: Serve, ahead: Ahead) -> None:
    """aiohttp forgets them after ten idle seconds; their sockets are open for as long as the peer takes nothing."""
    async with serve(config=ServerConfig(port=0, limits=WAITING)) as server:
        ahead.lead()
        loop = asyncio.get_running_loop()
        peers, transports = [], []
        assert server._runner is not None and server._runner.server is not None
        connections = server._runner.server._connections  # and their transports
        page = get("/vr/").replace("close", "keep-alive").encode()
        for _ in range(6):
            peers.append(peer := small_peer(server))
            await until(lambda: [one for one in connections.values() if one not in transports])
            (transport,) = (one for one in connections.values() if one not in transports)
            transports.append(transport)
            while transport.get_write_buffer_size() == 0:
                await loop.sock_sendall(peer, page)
                await asyncio.sleep(0.001)
        ahead.leap(11)
        await until(lambda: all(one.transport is None for one in connections))
        assert status(await ask(server.port, get("/healthz"), "127.0.0.2")) == 200
        assert open_ones(transports) <= 3  # one made room
        for peer in peers:
            peer.close()


@pytest.mark.extra(name="operations")
async def test_requests_that_take_long_leave_room_for_others(serve: Serve) -> None:
    """One address may keep no more than half of the places busy: here with a picture that is not drawn."""
    backend = FakeBackend()
    backend.gate.clear()
    async with serve(backend, ServerConfig(port=0, limits=WAITING)) as server:
        asked = [asyncio.create_task(ask(server.port, get("/thumbnails/default"), "127.0.0.2")) for _ in range(4)]
        await until(lambda: sum(one.busy for one in server.gate._listener._waiting) == 4)  # type: ignore[union-attr]
        assert status(await ask(server.port, get("/healthz"), "127.0.0.3")) == 200
        backend.gate.set()
        assert [status(answer) for answer in await asyncio.gather(*asked)].count(200) == 3
