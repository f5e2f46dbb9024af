"""Who gets splats and poses: tokens, accounts, rooms; and what a client that takes nothing costs."""

from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import aiohttp

from glsplat.extras.accounts.users import Accounts, new_user, write_users
from glsplat.extras.browser.feature import SplatFiles
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.reply import parse_reply
from glsplat.net.server import Server
from tests.extras.browser.poses.conftest import OFFERS, config, head
from tests.net.conftest import FakeBackend, Serve
from tests.net.wire import HANG, UNLIMITED, until


async def status(server: Server, digest: str, token: str | None = None) -> int:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    url = f"http://127.0.0.1:{server.port}/splats/{digest}"
    async with aiohttp.ClientSession() as web, web.get(url, headers=headers) as answer:
        text = await answer.text(errors="replace")
        assert answer.status == 200 or text.count("\n") <= 1
        return answer.status


def digest_of(server: Server, name: str = "ann") -> str:
    digest = server.feature(SplatFiles).file_digest(name)
    assert digest is not None
    return digest.hex()


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
            await until(lambda: not server.clients)
            assert await all_of_them() == {"ann": 200, "bob": 404, "eve": 404}

    asyncio.run(talk())


async def test_the_window_holds_poses_too(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann", limits=UNLIMITED), offered=OFFERS) as server:
        async with aiohttp.ClientSession() as web:
            ws = await web.ws_connect(f"{server.url}?avatar=ann&window=2")
            for number in range(1, 21):
                request: dict[str, Any] = {"v": 1, "frame_id": number, "ack": 0, "want": "pose"}
                await ws.send_str(json.dumps(request | {"tracking": head(number), "t": number * 14.0}))
                if number <= 2:
                    assert parse_reply((await ws.receive(timeout=HANG)).data).frame_id == number
            (stream,) = server.clients.values()
            await until(lambda: stream.session.counts.accepted == 20)
            assert stream.session.counts.sent == 2 and stream.answers.empty()
            await ws.send_str(json.dumps({"v": 1, "ack": 2}))
            last = parse_reply((await ws.receive(timeout=HANG)).data)
            assert last.frame_id == 20 and last.bodies[0].pose.trans[0] == 20
            await ws.close()
