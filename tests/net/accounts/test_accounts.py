"""Accounts over real sockets: who comes in, what each is offered, who is put out."""

from __future__ import annotations

import asyncio
import base64
import logging
import threading

import aiohttp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glsplat.errors import ProtocolError
from glsplat.net.accounts import users
from glsplat.net.accounts.users import Accounts, User, new_user, write_users
from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard import gate
from glsplat.net.guard.access import Access
from glsplat.net.messages import WireOptions
from glsplat.net.options import client_options
from glsplat.net.rights import Rights
from glsplat.net.server import ServerConfig
from glsplat.net.session import SessionConfig
from glsplat.skinning.skeleton import Skeleton
from tests.net.wire import HANG, until

RIG = Skeleton.from_joints(["root"], [-1], [[0.0, 0.0, 0.0]])  # people of rooms have joints
OFFERED = tuple(AvatarInfo(name=name, skeleton=RIG) for name in ("default", "ann", "bob"))
WS = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "A" * 22 + "==",
}


@pytest.fixture
def made(tmp_path):
    """A configuration with three accounts, their tokens, and the file."""
    accounts = {
        "ann": new_user("ann", ["ann"], ["lab"]),
        "boss": new_user("boss"),
        "eve": new_user("eve", [], []),
    }
    path = tmp_path / "users.json"
    write_users(path, {name: user for name, (user, _) in accounts.items()})
    config = ServerConfig(port=0, access=Access(accounts=Accounts(path)), rooms={"lab": 4, "hall": 4})
    return config, {name: token for name, (_, token) in accounts.items()}, path


async def get(server, path, token=None, **headers):
    headers |= {"Authorization": f"Bearer {token}"} if token else {}
    async with (
        aiohttp.ClientSession() as http,
        http.get(f"http://127.0.0.1:{server.port}{path}", headers=headers) as answer,
    ):
        return answer.status, await answer.text()


def test_each_address_wants_an_account_and_the_page_none(serve, made):
    config, tokens, _ = made

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            paths = ("/", "/stats", "/metrics", "/session", "/motions/walk", "/recording")
            bare = [(await get(server, path))[0] for path in (*paths, "/ws")]
            own = [(await get(server, path, tokens["ann"]))[0] for path in paths]
            return bare, own, [(await get(server, path))[0] for path in ("/healthz", "/vr")]

    bare, own, public = asyncio.run(main())
    assert bare == [401] * 7 and own == [200] * 6 and public == [200, 200]


def test_a_token_goes_all_the_ways(serve, made, cameras, caplog):
    caplog.set_level(logging.DEBUG)
    config, tokens, _ = made

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            async with Client(server.url, tokens["boss"]) as client:
                first = (await client.render(cameras)).frame_id
            async with (
                aiohttp.ClientSession() as http,
                http.ws_connect(server.url, protocols=("glsplat.v1", f"token.{tokens['ann']}")) as ws,
            ):
                spoken = ws.protocol
            basic = base64.b64encode(f"anything:{tokens['ann']}".encode()).decode()
            status = (await get(server, "/", Authorization=f"Basic {basic}"))[0]
            wrong = (await get(server, "/session", tokens["ann"][:-1]))[0]
            return first, spoken, status, wrong

    assert asyncio.run(main()) == (1, "glsplat.v1", 200, 401)
    assert not any(token.partition(".")[2] in caplog.text for token in tokens.values())


def test_what_is_offered_and_what_is_refused(serve, made):
    config, tokens, _ = made

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            offers = {}
            for name, token in tokens.items():
                async with aiohttp.ClientSession(headers={"Authorization": f"Bearer {token}"}) as http:
                    async with http.get(f"http://127.0.0.1:{server.port}/session") as answer:
                        offers[name] = [one["name"] for one in (await answer.json())["avatars"]]
            asked = ("", "?avatar=bob", "?avatar=nobody", "?avatar=../ann", "?avatar=%2e%2e%2fann", "?room=hall")
            asked += ("?room=../lab", "?avatar=ann&room=lab%00", "?avatar=ann&room=")
            ann = [await get(server, f"/ws{query}", tokens["ann"], **WS) for query in asked[1:]]
            eve = [await get(server, f"/ws{query}", tokens["eve"], **WS) for query in asked]
            boss = [(await get(server, f"/ws?{query}", tokens["boss"], **WS))[0] for query in ("avatar=x", "room=../x")]
            async with Client(f"{server.url}?room=lab", tokens["ann"]):
                shown = [channel.shown.name for channel in server._channels.values()]
            return offers, ann, eve, boss, shown

    offers, ann, eve, boss, shown = asyncio.run(main())
    assert offers == {"ann": ["ann"], "boss": ["default", "ann", "bob"], "eve": []} and shown == ["ann"]
    assert [status for status, _ in ann + eve] == [403] * 17 and boss == [403, 403]
    for _, text in ann + eve:
        assert not {"bob", "default", "boss"} & set(text.replace(",", " ").split()), text
    assert ann[0] == ann[1]  # an avatar that is there reads like one that is not
    assert not any("ann" in text.split() for _, text in eve)


def test_guesses_are_counted_one_by_one_also_when_they_come_at_once(serve, made, monkeypatch):
    config, tokens, _ = made
    hashes, hashed = [], users._hashed
    monkeypatch.setattr(users, "_hashed", lambda token, salt: hashes.append(token) or hashed(token, salt))

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            assert (await get(server, "/session", tokens["boss"]))[0] == 200
            before = len(hashes)
            guesses = [get(server, "/session", f"ann.guess{i}") for i in range(16)]
            statuses = [status for status, _ in await asyncio.gather(*guesses)]
            return statuses, len(hashes) - before, (await get(server, "/session", tokens["boss"]))[0]

    statuses, hashed_of_them, right = asyncio.run(main())
    assert set(statuses) == {401, 429} and statuses.count(401) == hashed_of_them <= 6 and right == 429


def test_who_is_removed_is_put_out(serve, made, cameras, monkeypatch):
    config, tokens, path = made
    monkeypatch.setattr(users, "_LOOK", 0.0)

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            async with Client(server.url, tokens["ann"]) as ann, Client(server.url, tokens["boss"]) as boss:
                await ann.render(cameras)
                write_users(path, {name: user for name, user in users.read_users(path).items() if name != "ann"})
                with pytest.raises(ProtocolError) as told:
                    await ann.render(cameras)
                still = (await boss.render(cameras)).frame_id
            with pytest.raises(ProtocolError, match="401"):
                async with Client(server.url, tokens["ann"]):
                    pass
            return told.value.code, still

    code, still = asyncio.run(main())
    assert code in ("not_allowed", "closed") and still == 1


NAMES = st.sampled_from(["default", "ann", "bob", "lab", "*", "", ".."]) | st.text(max_size=70)


@pytest.mark.check
@settings(max_examples=200, deadline=None)
@given(
    query=st.fixed_dictionaries({}, optional={"avatar": NAMES, "room": NAMES}),
    avatars=st.lists(st.sampled_from(["default", "ann", "bob", "gone"]), max_size=2),
    rooms=st.lists(st.sampled_from(["lab", "hall"]), max_size=2),
)
def test_no_query_leads_to_what_an_account_may_not(query, avatars, rooms):
    user = User("eve", tuple(avatars), tuple(rooms))
    names = tuple(one.name for one in OFFERED)
    try:
        asked = client_options(query, WireOptions(), SessionConfig(), names, Rights(), user)
    except ProtocolError as error:
        forbidden = set(names) - set(avatars)
        assert not any(f" {name}" in str(error).replace(",", "") for name in forbidden if name not in query.values())
        if query.get("avatar") not in (None, *avatars):
            assert error.code == "not_allowed"
        return
    assert asked.avatar in avatars and query.get("avatar", asked.avatar) == asked.avatar
    assert query.get("room", "lab") in rooms or "room" not in query


def test_one_token_is_as_before(serve, cameras):
    """And who has it may drive and enter everything."""
    config = ServerConfig(port=0, access=Access(token="0123456789abcdef"), rooms={"hall": 4})

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            async with Client(f"{server.url}?room=hall", "0123456789abcdef", avatar="bob") as client:
                return (await client.render(cameras)).frame_id

    assert asyncio.run(main()) == 1


def test_only_so_many_tokens_wait_to_be_looked_at(serve, made, monkeypatch):
    """And who was let in before does not wait behind them."""
    config, tokens, _ = made
    hashed, opened = users._hashed, threading.Event()
    monkeypatch.setattr(gate, "_MOST_LOGINS", 2)

    async def main():
        async with serve(config=config, offered=OFFERED) as server:
            first = (await get(server, "/session", tokens["boss"]))[0]
            monkeypatch.setattr(users, "_hashed", lambda *words: opened.wait(HANG) and hashed(*words))
            waiting = [asyncio.create_task(get(server, "/session", f"eve.guess{i}")) for i in range(4)]
            await until(lambda: sum(task.done() for task in waiting) == 2)
            known = (await get(server, "/session", tokens["boss"]))[0]
            assert sum(task.done() for task in waiting) == 2
            opened.set()
            return first, known, sorted([status for status, _ in await asyncio.gather(*waiting)])

    assert asyncio.run(main()) == (200, 200, [401, 401, 429, 429])
