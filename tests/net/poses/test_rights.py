"""Who gets splats and poses: tokens, accounts, rooms; and what a client that takes nothing costs."""

from __future__ import annotations

import asyncio
import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from glsplat.net.accounts.users import Accounts, new_user, write_users
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.reply import parse_reply
from glsplat.net.server import Server
from tests.net.conftest import FakeBackend, Serve
from tests.net.loops import in_a_loop
from tests.net.poses.conftest import OFFERS, config, head
from tests.net.wire import HANG, UNLIMITED, until


async def status(server: Server, digest: str, token: str | None = None) -> int:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    url = f"http://127.0.0.1:{server.port}/splats/{digest}"
    async with aiohttp.ClientSession() as web, web.get(url, headers=headers) as answer:
        text = await answer.text(errors="replace")
        assert answer.status == 200 or text.count("\n") <= 1
        return answer.status


def digest_of(server: Server, name: str = "ann") -> str:
    digest = server._splat_files.sha256(name)
    assert digest is not None
    return digest.hex()


@in_a_loop
async def test_a_token_is_wanted_for_splats(serve: Serve) -> None:
    access = Access(token="0123456789abcdef")
    async with serve(FakeBackend(), config("ann", access=access), offered=OFFERS) as server:
        digest = digest_of(server)
        assert [await status(server, digest, token) for token in (None, "f" * 16, access.token)] == [401, 401, 200]


def test_accounts_get_whom_they_drive_or_meet(serve: Serve, tmp_path: Path) -> None:
    accounts = {"ann": new_user("ann", ["ann"], ["lab"]), "bob": new_user("bob", ["bob"], ["lab"])}
    accounts["eve"] = new_user("eve", ["bob"], [])
    write_users(tmp_path / "users.json", {name: user for name, (user, _) in accounts.items()})
    tokens = {name: token for name, (_, token) in accounts.items()}

    async def talk() -> None:
        access = Access(accounts=Accounts(tmp_path / "users.json"))
        offers = tuple(replace(one, file=one.file if one.name == "ann" else None) for one in OFFERS)
        async with serve(FakeBackend(), config("ann", "bob", access=access), offered=offers) as server:
            digest = digest_of(server)

            async def all_of_them() -> dict[str, int]:
                return {name: await status(server, digest, token) for name, token in tokens.items()}

            assert await all_of_them() == {"ann": 200, "bob": 404, "eve": 404}
            url = f"{server.url}?room=lab&avatar=ann"
            async with Client(url, tokens["ann"], timeout=HANG) as client:
                await client.poses(tracking=head())
                assert await all_of_them() == {"ann": 200, "bob": 200, "eve": 404}
                seen = Client(f"{server.url}?room=lab&avatar=bob", tokens["bob"], timeout=HANG)
                async with seen as other:
                    reply = await other.poses(tracking=head())
                    assert [body.sha256 for body in reply.bodies] == [digest]  # bob is nothing a browser draws
            await until(lambda: not server._channels)
            assert await all_of_them() == {"ann": 200, "bob": 404, "eve": 404}

    asyncio.run(talk())


@in_a_loop
async def test_the_window_holds_poses_too(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann", limits=UNLIMITED), offered=OFFERS) as server:
        async with aiohttp.ClientSession() as web:
            ws = await web.ws_connect(f"{server.url}?avatar=ann&window=2")
            for number in range(1, 21):
                request: dict[str, Any] = {"v": 1, "frame_id": number, "ack": 0, "want": "pose"}
                await ws.send_str(json.dumps(request | {"tracking": head(number), "t": number * 14.0}))
                if number <= 2:
                    assert parse_reply((await ws.receive(timeout=HANG)).data).frame_id == number
            (channel,) = server._channels.values()
            await until(lambda: channel.session.counts.accepted == 20)
            assert channel.session.counts.sent == 2 and channel.frames.empty()
            await ws.send_str(json.dumps({"v": 1, "ack": 2}))
            last = parse_reply((await ws.receive(timeout=HANG)).data)
            assert last.frame_id == 20 and last.bodies[0].pose.trans[0] == 20
            await ws.close()


@pytest.mark.check
@in_a_loop
async def test_answers_leave_nothing_behind(serve: Serve) -> None:
    settings = config("ann", limits=UNLIMITED)
    settings = replace(settings, session=replace(settings.session, rate=1e9, burst=10**9))
    async with serve(FakeBackend(), settings, offered=OFFERS) as server:

        async def visit(count: int) -> None:
            async with Client(f"{server.url}?room=lab&name=Ann&avatar=ann", timeout=HANG) as one:
                for number in range(count):
                    await one.poses(tracking=head(number) if number % 3 else None)
            await until(lambda: not server._channels)

        for _ in range(2):
            await visit(50)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(4):
            await visit(50)
        grown = tracemalloc.get_traced_memory()[0] - before
        tracemalloc.stop()
        assert grown < 200_000, grown
        room = server._rooms._rooms["lab"]
        assert not room._guests and not room._news
