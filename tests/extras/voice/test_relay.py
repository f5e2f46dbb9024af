"""The relay of signals: who gets them, what is refused, and a good pair of pages beside a hostile one."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import json
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from random import Random
from typing import Any

import aiohttp
import numpy as np
import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.accounts.users import User
from glsplat.extras.voice import IceServers, Voice
from glsplat.extras.voice.relay import MAX_MESSAGE_BYTES, MAX_TALKERS
from glsplat.net.backend import AvatarInfo
from glsplat.net.guard.access import Access
from glsplat.net.options import ServerConfig
from glsplat.net.server import Server
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.net.conftest import FakeBackend, Serve
from tests.net.wire import EYE, HANG, UNLIMITED, until

pytestmark = pytest.mark.extra(name="speech")

RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))
OFFERS = (AvatarInfo(name="ann", skeleton=RIG),)
LAB: dict[str, Any] = {"rooms": {"lab": 16, "hall": 4}, "max_clients": 16, "limits": UNLIMITED}


class Page:
    """A client of a room that sends and reads messages to others."""

    def __init__(self, ws: aiohttp.ClientWebSocketResponse) -> None:
        self.ws = ws
        self.frame_id = 0

    async def talk(self, **fields: Any) -> None:
        await self.ws.send_str(json.dumps({"talk": fields}))

    async def heard(self, kind: type = str) -> Any:
        """Return the next text message's ``talk`` (or ``error``), or with ``bytes`` the next reply."""
        async with asyncio.timeout(HANG):
            while True:
                message = await self.ws.receive()
                if isinstance(message.data, kind):
                    if kind is bytes:
                        return message.data
                    found = json.loads(str(message.data))
                    return found.get("talk", found.get("error"))
                assert message.type in (aiohttp.WSMsgType.BINARY, aiohttp.WSMsgType.TEXT), message

    async def join(self) -> Any:
        await self.talk(join=True)
        return await self.heard()

    async def picture(self) -> bytes:
        self.frame_id += 1
        request = {"v": 1, "frame_id": self.frame_id, "ack": 0, "eyes": [EYE], "size": [64, 64]}
        await self.ws.send_str(json.dumps(request))
        return await self.heard(bytes)


@asynccontextmanager
async def page(server: Server, name: str, room: str = "lab", token: str = "") -> AsyncIterator[Page]:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    who = "" if token else f"&name={name}"
    async with aiohttp.ClientSession() as http:
        async with http.ws_connect(f"{server.url}?room={room}{who}", headers=headers) as ws:
            yield Page(ws)


@asynccontextmanager
async def lab(serve: Serve, ice: IceServers | None = None, **config: Any) -> AsyncIterator[Server]:
    async with serve(
        FakeBackend(), ServerConfig(port=0, **LAB | config), offered=OFFERS, features=[Voice(ice)]
    ) as server:
        yield server


async def test_signals_reach_one_member_of_the_same_room_as_they_are(serve: Serve) -> None:
    async with lab(serve) as server, page(server, "Ann") as ann, page(server, "Bob") as bob, page(server, "Cy") as cy:
        first = await ann.join()
        assert first == {"you": 1, "peers": [], "iceServers": [], "iceTransportPolicy": "all"}
        assert (await bob.join())["peers"] == [{"id": 1, "name": "Ann"}]
        assert await ann.heard() == {"joined": {"id": 2, "name": "Bob"}}
        async with page(server, "Dee", "hall") as dee:
            key = (await dee.join())["you"]
            await dee.talk(to=2, signal="from another room")
            await ann.talk(to=key + 100, signal="to nobody")
            await cy.talk(to=2, signal="has not joined")
            text = 'v=0\r\n"ü" </script> \u0000'
            await ann.talk(to=2, signal=text, sdp={"unknown": [1]}, more=None)
            assert await bob.heard() == {"from": 1, "signal": text}
        await bob.talk(join=False)
        assert await ann.heard() == {"left": 2}
        await bob.join()
        await ann.heard()
        await bob.ws.close()
        assert await ann.heard() == {"left": 2}
        assert server.stats()["talk"] == {"people": 1, "signals": 1, "bytes": pytest.approx(120, abs=60)}
        assert server.session()["talk"] == {"relay": False}


async def test_ninth_is_refused_and_a_client_alone_has_no_relay(serve: Serve) -> None:
    async with lab(serve) as server:
        async with AsyncExitStack() as stack:
            for number in range(MAX_TALKERS):
                assert "you" in await (await stack.enter_async_context(page(server, f"P{number}"))).join()
            ninth = await stack.enter_async_context(page(server, "Ninth"))
            assert (await ninth.join())["code"] == "talk_full"
        async with aiohttp.ClientSession() as http, http.ws_connect(server.url) as alone:
            await alone.send_str('{"talk": {"join": true}}')
            assert json.loads((await alone.receive()).data)["error"]["code"] == "version"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (f'{{"talk": {{"to": 1, "signal": "{"x" * MAX_MESSAGE_BYTES}"}}}}', "too_big"),
        ('{"talk": {"to": 1, "signal": {"sdp": 1}}}', "bad_field"),
        ('{"talk": 7}', "bad_field"),
        ('{"talk": {"to": 1e400}}', "bad_field"),
        (f'{{"talk": {{"more": {"[" * 5000}1{"]" * 5000}}}}}', "bad_json"),
        ('{"talk": {"to": 1, "signal": "\\ud800"}}', "bad_json"),
        (' {\n"talk": {', "bad_json"),
    ],
)
async def test_malformed_messages_are_refused_in_a_line(serve: Serve, text: str, code: str) -> None:
    async with lab(serve) as server, page(server, "Ann") as ann:
        await ann.join()
        await ann.ws.send_str(text)
        found = await ann.heard()
        assert found["code"] == code and "\n" not in found["message"]
        assert await ann.picture()


async def test_a_hostile_member_ends_and_the_others_go_on(serve: Serve) -> None:
    """Floods of legal signals are cut down to the rate, garbage ends the connection; neither reaches others whole."""
    chance = Random(5)
    async with lab(serve) as server, page(server, "Ann") as ann, page(server, "Bob") as bob, page(server, "Eve") as eve:
        for one in (ann, bob, eve):
            await one.join()
        big = json.dumps({"talk": {"to": 1, "signal": "x" * (MAX_MESSAGE_BYTES - 100)}})
        for _ in range(400):
            garbage = chance.choice(("{}", '{"join": 1}', '{"to": [], "signal": 0}', '"' + "ÿ" * 50 + '"'))
            await eve.ws.send_str(f'{{"talk": {garbage}}}' if chance.random() < 0.3 else big)
            if eve.ws.closed:
                break
        async with asyncio.timeout(HANG):
            while not eve.ws.closed:
                await eve.ws.receive()
        assert eve.ws.close_code == 1008
        await ann.talk(to=2, signal="hello")
        while "signal" not in (found := await bob.heard()):
            pass
        assert found == {"from": 1, "signal": "hello"}
        await bob.talk(to=1, signal="here")
        count, found = 0, {}
        while found != {"from": 2, "signal": "here"}:
            found = await ann.heard()
            count += found.get("from") == 3
        assert count <= 512 * 1024 // len(big) + 8  # the burst of bytes, and what the test's time refills
        assert await ann.picture() and await bob.picture()
        assert server.stats()["talk"]["bytes"] < 700_000


async def test_who_joins_again_and_again_ends(serve: Serve) -> None:
    async with lab(serve) as server, page(server, "Ann") as ann, page(server, "Eve") as eve:
        await ann.join()
        for _ in range(40):
            await eve.talk(join=True)
        async with asyncio.timeout(HANG):
            while not eve.ws.closed:
                await eve.ws.receive()
        await ann.talk(join=False)
        joined = 0
        await until(lambda: len(server.clients) == 1)
        await ann.talk(join=True)
        while "you" not in (found := await ann.heard()):
            joined += "joined" in found
        assert 5 < joined < 15


async def test_a_member_who_reads_nothing_holds_no_memory(serve: Serve) -> None:
    async with lab(serve) as server, page(server, "Ann") as ann, page(server, "Bob") as bob:
        await ann.join()
        await bob.join()
        client = next(one for one in server.clients.values() if one.driver == "Ann")
        for _ in range(1000):
            client.say("x")
        assert client.answers.qsize() <= 256


class Accounts:
    """Ann and Bob; Bob may enter the hall only. ``gone`` are those whose rights changed."""

    def __init__(self) -> None:
        self.users = {"ann.1": _user("ann", "*"), "bob.1": _user("bob", "hall")}
        self.gone: set[str] = set()

    def known(self, token: str) -> User | None:
        return self.users.get(token)

    async def verified(self, token: str) -> User | None:
        return self.users.get(token)

    def holds(self, user: User) -> bool:
        return user.name not in self.gone


def _user(name: str, rooms: str) -> User:
    return User(name=name, rooms=(rooms,))


async def test_who_may_not_be_in_the_room_may_not_signal(serve: Serve) -> None:
    accounts = Accounts()
    async with lab(serve, access=Access(accounts=accounts, insecure=True)) as server:
        async with page(server, "", token="ann.1") as ann:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with page(server, "", token="bob.1"):
                    pass
            assert refused.value.status == 403
            await ann.join()
            accounts.gone.add("ann")
            await ann.talk(to=1, signal="to myself")
            assert (await ann.heard())["code"] == "not_allowed"
            await until(lambda: not server.clients)


def test_pages_get_a_password_of_their_own_and_no_third_party_by_default() -> None:
    assert IceServers().configuration(0.0)["iceServers"] == []
    ice = IceServers(
        ("stun:s.example", "turn:t.example:3478", "turns:t.example?transport=tcp"), "0123456789abcdef", True
    )
    assert "0123456789abcdef" not in repr(ice)
    found = ice.configuration(1000.0)
    user = f"{1000 + 12 * 3600}:glsplat"
    digest = hmac.new(b"0123456789abcdef", user.encode(), hashlib.sha1).digest()
    turn = {"urls": ["turn:t.example:3478", "turns:t.example?transport=tcp"], "username": user}
    assert found == {
        "iceServers": [{"urls": "stun:s.example"}, turn | {"credential": base64.b64encode(digest).decode()}],
        "iceTransportPolicy": "relay",
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((("https://t.example",),), "stun:HOST"),
        ((("turn:t.example",),), "no secret"),
        (((), "0123456789abcdef"), "no turn: address"),
        ((("stun:s.example",), "", True), "relay only"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: Any, words: str) -> None:
    with pytest.raises(GlsplatError, match=words):
        IceServers(*options)
