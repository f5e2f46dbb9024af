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
from glsplat.extras.accounts import users
from glsplat.extras.accounts.users import Accounts, User, new_user, write_users
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
WS = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
WS |= {"Sec-WebSocket-Key": "A" * 22 + "=="}


@pytest.fixture
def made(tmp_path):
    """A configuration with three accounts, their tokens, and the file."""
    accounts = {"ann": new_user("ann", ["ann"], ["lab"]), "boss": new_user("boss"), "eve": new_user("eve", [], [])}
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


async def test_a_token_goes_all_the_ways(serve, made, cameras, caplog):
    caplog.set_level(logging.DEBUG)
    config, tokens, _ = made
    protocols = ("glsplat.v1", f"token.{tokens['ann']}")
    basic = base64.b64encode(f"anything:{tokens['ann']}".encode()).decode()
    async with serve(config=config, offered=OFFERED) as server, aiohttp.ClientSession() as http:
        async with Client(server.url, tokens["boss"]) as client:
            assert (await client.render(cameras)).frame_id == 1
        async with http.ws_connect(server.url, protocols=protocols) as ws:
            assert ws.protocol == "glsplat.v1"
        assert (await get(server, "/", Authorization=f"Basic {basic}"))[0] == 200
        assert (await get(server, "/session", tokens["ann"][:-1]))[0] == 401
    assert not any(token.partition(".")[2] in caplog.text for token in tokens.values())


async def test_refusals_name_nothing_that_is_not_the_askers(serve, made):
    config, tokens, _ = made
    asked = ["?avatar=bob", "?avatar=nobody", "?avatar=../ann", "?avatar=%2e%2e%2fann", "?room=hall", "?room=../lab"]
    asked += ["?avatar=ann&room=lab%00", "?avatar=ann&room="]
    async with serve(config=config, offered=OFFERED) as server:
        for name, queries in (("ann", asked), ("eve", ["", *asked])):
            for query in queries:
                status, text = await get(server, f"/ws{query}", tokens[name], **WS)
                assert status == 403 and not {"bob", "default", "boss"} & set(text.replace(",", " ").split())
                assert name == "ann" or "ann" not in text.split()
        async with Client(f"{server.url}?room=lab", tokens["ann"]):
            assert [stream.shown.name for stream in server.clients.values()] == ["ann"]


async def test_guesses_are_counted_one_by_one_also_when_they_come_at_once(serve, made, monkeypatch):
    config, tokens, _ = made
    hashes, hashed = [], users._hash_token
    monkeypatch.setattr(users, "_hash_token", lambda token, salt: hashes.append(token) or hashed(token, salt))
    async with serve(config=config, offered=OFFERED) as server:
        assert (await get(server, "/session", tokens["boss"]))[0] == 200
        before = len(hashes)
        guesses = [get(server, "/session", f"ann.guess{i}") for i in range(16)]
        statuses = [status for status, _ in await asyncio.gather(*guesses)]
        hashed_of_them, right = len(hashes) - before, (await get(server, "/session", tokens["boss"]))[0]
    assert set(statuses) == {401, 429} and statuses.count(401) == hashed_of_them <= 6 and right == 429


async def test_removing_an_account_ends_its_connections(serve, made, cameras, monkeypatch):
    config, tokens, path = made
    monkeypatch.setattr(users, "CHECK_S", 0.0)
    async with serve(config=config, offered=OFFERED) as server:
        async with Client(server.url, tokens["ann"]) as ann, Client(server.url, tokens["boss"]) as boss:
            await ann.render(cameras)
            write_users(path, {name: user for name, user in users.read_users(path).items() if name != "ann"})
            with pytest.raises(ProtocolError) as told:
                await ann.render(cameras)
            assert told.value.code in ("not_allowed", "closed")
            assert (await boss.render(cameras)).frame_id == 1
        with pytest.raises(ProtocolError, match="401"):
            await Client(server.url, tokens["ann"]).connect()


NAMES = st.sampled_from(["default", "ann", "bob", "lab", "*", "", ".."]) | st.text(max_size=70)


@pytest.mark.check
@settings(max_examples=100, deadline=None)
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


async def test_only_so_many_tokens_wait_to_be_looked_at(serve, made, monkeypatch):
    """And who was let in before does not wait behind them."""
    config, tokens, _ = made
    hashed, opened = users._hash_token, threading.Event()
    monkeypatch.setattr(gate, "_MAX_LOGINS", 2)
    async with serve(config=config, offered=OFFERED) as server:
        first = (await get(server, "/session", tokens["boss"]))[0]
        monkeypatch.setattr(users, "_hash_token", lambda *words: opened.wait(HANG) and hashed(*words))
        waiting = [asyncio.create_task(get(server, "/session", f"eve.guess{i}")) for i in range(4)]
        await until(lambda: sum(task.done() for task in waiting) == 2)
        known = (await get(server, "/session", tokens["boss"]))[0]
        assert sum(task.done() for task in waiting) == 2
        opened.set()
        assert first == known == 200
        assert sorted([status for status, _ in await asyncio.gather(*waiting)]) == [401, 401, 429, 429]
