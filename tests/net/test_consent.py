"""Consent on a running server: who comes in, and what happens to a session while it ends."""

from __future__ import annotations

from dataclasses import replace

import aiohttp
import pytest

from glsplat.errors import ProtocolError
from glsplat.extras.accounts.users import Accounts, new_user, write_users
from glsplat.extras.consent.document import Consent
from glsplat.extras.consent.file import OnFile
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.net import rights
from glsplat.net.backend import AvatarInfo
from glsplat.net.client import Client
from glsplat.net.guard.access import Access
from glsplat.net.served_scene import gl_server
from glsplat.net.server import ServerConfig
from tests.extras.accounts.test_accounts import WS
from tests.net.wire import until
from tests.scenes import limb

CONSENT = Consent(
    **{"subject": "Ann", "given_by": "Ann", "purpose": "a test", "key": "0" * 64},
    **{"begins": 1000.0, "ends": 2000.0, "drivers": frozenset("*"), "splats_sha256": "0" * 64, "file_sha256": None},
)


class Clock:
    now = 1500.0

    def time(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(rights, "time", clock)
    return clock


def config(people, **more):
    policy = ConsentPolicy()
    policy.add("ann", people)
    return ServerConfig(port=0, consent=policy, **more)


async def refused(server, token=""):
    """The answer to a handshake, which lets nobody in."""
    headers = WS | ({"Authorization": f"Bearer {token}"} if token else {})
    url = f"http://127.0.0.1:{server.port}/ws"
    async with aiohttp.ClientSession() as http, http.get(url, headers=headers) as answer:
        assert answer.status == 403
        return await answer.text()


async def test_a_session_ends_when_the_consent_does(serve, fake_backend, cameras, clock):
    backend = fake_backend()
    async with serve(backend, config([OnFile(CONSENT)]), offered=[AvatarInfo(name="ann")]) as server:
        async with Client(server.url) as client:
            await client.render(cameras)
            clock.now = 2000.0
            with pytest.raises(ProtocolError, match="ended on 1970-01-01") as told:
                await client.render(cameras)
            assert told.value.code == "not_allowed"
            await until(lambda: not server.stats()["clients"])
        assert len(backend.drawn) == 1 and "ended on 1970-01-01" in await refused(server)


@pytest.mark.parametrize("people", [[], [OnFile(nobody=True)], [OnFile(CONSENT)]])
async def test_with_consent_the_avatar_is_shown(serve, cameras, clock, people):
    async with serve(config=config(people), offered=[AvatarInfo(name="ann")]) as server, Client(server.url) as client:
        assert (await client.render(cameras)).frame_id == 1


@pytest.mark.parametrize(
    ("people", "why"),
    [
        ([OnFile(CONSENT), OnFile(fault="no consent on file")], "no consent on file"),
        ([OnFile(replace(CONSENT, begins=1600.0))], "begins"),
        ([OnFile(replace(CONSENT, drivers=frozenset(["bob"])))], "that is not you"),
    ],
)
async def test_without_consent_nobody_comes_in(serve, clock, people, why):
    async with serve(config=config(people), offered=[AvatarInfo(name="ann")]) as server:
        text = await refused(server)
    assert why in text and text.count("\n") == 1


async def test_drivers_are_accounts(serve, cameras, clock, tmp_path):
    made = {name: new_user(name) for name in ("ann", "bob")}
    write_users(tmp_path / "users.json", {name: user for name, (user, _) in made.items()})
    access = Access(accounts=Accounts(tmp_path / "users.json"))
    people = [OnFile(replace(CONSENT, drivers=frozenset(["bob"])))]
    async with serve(config=config(people, access=access), offered=[AvatarInfo(name="ann")]) as server:
        async with Client(server.url, made["bob"][1]) as client:
            await client.render(cameras)
        text = await refused(server, made["ann"][1])
    assert not {"ann", "bob"} & set(text.replace('"', " ").split()), text  # as if it were not there


def test_a_program_that_makes_a_server_is_not_asked():
    assert gl_server(limb(20)).config.consent is None
    policy = ConsentPolicy()
    assert gl_server(limb(20), ServerConfig(consent=policy)).config.consent is policy
