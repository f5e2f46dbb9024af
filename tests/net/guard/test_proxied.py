"""Behind a trusted proxy each client has limits of its own; elsewhere nobody is believed who they are."""

from __future__ import annotations

import asyncio
import logging
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from glsplat.extras.uploads.job import UploadConfig
from glsplat.extras.uploads.routes import Uploads
from glsplat.net.backend import AvatarInfo
from glsplat.net.guard.access import Access
from glsplat.net.guard.forwarded import proxy_network
from glsplat.net.guard.limits import Limits
from glsplat.net.options import ServerConfig
from tests.extras.uploads.makers import make
from tests.net.conftest import Serve
from tests.net.wire import UPGRADE, all_of, ask, frame, get, native, status, until

TOKEN = "0123456789abcdef-token"
ANN, BOB, EVE = "192.0.2.1", "2001:db8::2", "198.51.100.3"


def config(limits: Limits | None = None, token: str | None = None, **more: Any) -> ServerConfig:
    access = Access(token=token, proxies=(proxy_network("127.0.0.1"),))
    return ServerConfig(port=0, access=access, limits=limits or Limits(), **more)


def of(client: str, path: str = "/stats", token: str | None = None, kept: bool = False) -> str:
    more = f"X-Forwarded-For: 6.6.6.6, {client}\r\n" + (f"Authorization: Bearer {token}\r\n" if token else "")
    return get(path, more=more).replace("close", "keep-alive" if kept else "close")


def upgrade(client: str) -> bytes:
    return UPGRADE.replace(b"Upgrade: websocket", f"X-Forwarded-For: {client}\r\nUpgrade: websocket".encode())


@asynccontextmanager
async def socket_of(port: int, client: str) -> Any:
    """A WebSocket, by way of the proxy."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(upgrade(client))
    head = await reader.readuntil(b"\r\n\r\n")
    try:
        yield head.decode().split(" ")[1], reader, writer
    finally:
        writer.transport.abort()


async def test_wrong_tokens_of_one_client_lock_nobody_else_out(serve: Serve, stopped: Any) -> None:
    async with serve(config=config(token=TOKEN)) as server:
        for number in range(8):
            await ask(server.port, of(EVE, token=f"wrong-token-{number:08d}"))
        assert [status(await ask(server.port, of(who, token=TOKEN))) for who in (EVE, ANN, BOB)] == [429, 200, 200]
        proxy = await ask(server.port, get(more=f"Authorization: Bearer {TOKEN}\r\n"))
        assert status(proxy) == 200


async def test_a_flooder_is_held_off_alone(serve: Serve, stopped: Any) -> None:
    async with serve(config=config()) as server, socket_of(server.port, EVE) as (_, reader, writer):
        writer.write(frame(0x1, native(1).encode()) + frame(0x9, b"") * 20_000)
        assert (1008).to_bytes(2, "big") + b"more than" in await all_of(reader)
        assert [status(await ask(server.port, of(who))) for who in (EVE, ANN, BOB)] == [429, 200, 200]
        async with socket_of(server.port, EVE) as (eve, *_), socket_of(server.port, ANN) as (ann, *_):
            assert (eve, ann) == ("429", "101")


async def test_one_connection_carries_requests_of_many(serve: Serve, stopped: Any) -> None:
    """As a proxy's pool does: each counts for its own client, and none for the connection."""
    limits = Limits(visits=1, visits_burst=5)
    async with serve(config=config(limits)) as server:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        codes = []
        for who in [EVE, ANN, BOB] * 5 + [EVE]:
            writer.write(of(who, kept=True).encode())
            head = await reader.readuntil(b"\r\n\r\n")
            codes.append(int(head.split(b" ")[1]))
            length = int(head.lower().partition(b"content-length: ")[2].split(b"\r\n")[0])
            await reader.readexactly(length)
        writer.transport.abort()
        assert codes == [200] * 15 + [429]


async def test_connections_of_a_proxy_are_not_counted_but_its_clients_requests(serve: Serve, stopped: Any) -> None:
    """A proxy without a pool connects for each request: only who asks too often is refused."""
    limits = Limits(visits=1, visits_burst=20)
    async with serve(config=config(limits)) as server:
        many = [status(await ask(server.port, of(f"192.0.2.{number}"))) for number in range(60)]
        eve = [status(await ask(server.port, of(EVE))) for _ in range(25)]
        stranger = [status(await ask(server.port, of(ANN), "127.0.0.2")) for _ in range(12)]
    assert many == [200] * 60 and eve == [200] * 20 + [429] * 5
    assert stranger == [200] * 10 + [None] * 2  # no proxy of ours: whom it names counts for nothing


@pytest.mark.parametrize("header", ["X-Forwarded-For: 192.0.2.1", "Forwarded: for=192.0.2.1"])
async def test_others_are_not_believed(serve: Serve, stopped: Any, header: str) -> None:
    """Who names another client at each request, without being a proxy, is one address all the same."""
    async with serve(config=config(token=TOKEN)) as server:
        tries = [
            get(more=f"{header.replace('.1', f'.{n}')}\r\nAuthorization: Bearer wrong-{n:016d}\r\n") for n in range(8)
        ]
        codes = [status(await ask(server.port, one, "127.0.0.5")) for one in tries]
        codes.append(status(await ask(server.port, get(more=f"Authorization: Bearer {TOKEN}\r\n"), "127.0.0.5")))
        async with serve(config=ServerConfig(port=0, access=Access(token=TOKEN))) as without:
            codes += [status(await ask(without.port, one)) for one in tries]
        assert codes == [401] * 6 + [429] * 3 + [401] * 6 + [429] * 2


async def test_what_names_no_client_counts_for_the_proxy(serve: Serve, stopped: Any, caplog: Any) -> None:
    caplog.set_level(logging.INFO)
    unclear = ["unknown", "_hidden", "for=192.0.2.1", f"{ANN}," * 300, ""]
    async with serve(config=config(Limits(visits_burst=5))) as server:
        codes = [status(await ask(server.port, get(more=f"X-Forwarded-For: {one}\r\n"))) for one in unclear]
        for _ in range(2):
            codes.append(status(await ask(server.port, get())))
            stopped.now += 100
        assert [*codes, status(await ask(server.port, of(ANN)))] == [200] * 5 + [429, 200, 200]
    lines = [record.getMessage() for record in caplog.records if record.name == "glsplat.net"]
    assert lines == [
        "a trusted proxy's header names no client; the proxy's own address counts",
        "a request of a trusted proxy has no X-Forwarded-For or Forwarded; its address counts",
    ]


async def test_photographs_of_one_client_do_not_use_up_anothers(serve: Serve, stopped: Any, tmp_path: Path) -> None:
    def post(client: str) -> str:
        text = of(client, "/avatars").replace("GET", "POST", 1)
        return text.replace("\r\n\r\n", "\r\nContent-Type: text/html\r\nContent-Length: 1\r\n\r\nx")

    uploads = Uploads(UploadConfig(folder=tmp_path, make=make), lambda name, avatar: AvatarInfo(name=name))
    async with serve(config=config(), features=[uploads]) as server:
        assert [status(await ask(server.port, post(who))) for who in [EVE] * 7 + [ANN]] == [415] * 6 + [429, 415]


async def test_an_address_has_half_of_the_places(serve: Serve) -> None:
    async with serve(config=config(max_clients=4)) as server:
        async with (
            socket_of(server.port, EVE) as (one, *_),
            socket_of(server.port, EVE) as (two, *_),
            socket_of(server.port, EVE) as (three, *_),
            socket_of(server.port, ANN) as (four, *_),
        ):
            assert [one, two, three, four] == ["101", "101", "429", "101"]
            assert sorted(stream.address for stream in server.clients.values()) == [ANN, EVE, EVE]
        await until(lambda: not server.clients)
        async with socket_of(server.port, EVE) as (again, *_):
            assert again == "101"


async def test_the_client_with_most_connections_makes_room(serve: Serve, stopped: Any) -> None:
    """Not the proxy's oldest one, though all come from the same peer."""

    async def opened(who: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(of(who, "/healthz", kept=True).encode())
        await reader.readuntil(b"ok\n")
        return reader, writer

    async with serve(config=config(Limits(waiting=10, visits_burst=1e9))) as server:
        held = [await opened(who) for who in [ANN] + [EVE] * 40]
        reader, writer = held[0]
        writer.write(of(ANN, "/healthz", kept=True).encode())
        assert (await reader.readuntil(b"ok\n")).startswith(b"HTTP/1.1 200")
        assert server.gate.status()["waiting"] == 10
        for _, writer in held:
            writer.transport.abort()
    assert server.gate.status()["turned_away"] == 31
