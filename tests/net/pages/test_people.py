"""Embedded people: offered by themselves, after clients can connect."""

from __future__ import annotations

import asyncio
import json
import pickle
import threading
from contextlib import asynccontextmanager
from dataclasses import replace

import aiohttp
import pytest

from apps.serve.wiring import assemble
from glsplat.data import PEOPLE, default_avatar, person
from glsplat.extras.consent.policy import ConsentPolicy
from glsplat.formats.scene_file import SceneFile
from glsplat.net.backend import AvatarInfo
from glsplat.net.backends.avatar_store import AvatarStore
from glsplat.net.served_scene import ServedScene, TrackingOptions, server_of
from glsplat.net.server import Server, ServerConfig
from glsplat.net.worker.worker import ThreadWorker
from tests.net.conftest import FakeBackend


async def session(server: Server) -> dict:
    async with aiohttp.ClientSession() as http, http.get(f"http://127.0.0.1:{server.port}/session") as answer:
        return json.loads(await answer.text())


@asynccontextmanager
async def started(server):
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


async def test_what_is_loaded_later_keeps_nobody_waiting():
    go_on = threading.Event()

    def later():
        yield AvatarInfo(name="default", height=9.0)  # the one of that name stays
        go_on.wait(60)
        yield AvatarInfo(name="late", height=1.7)

    async with started(server_of(FakeBackend(), ServerConfig(port=0), later=later)) as server:
        told = await session(server)
        assert told["loading"] and [(one["name"], one["height"]) for one in told["avatars"]] == [("default", None)]
        go_on.set()
        await asyncio.wait_for(server.all_offered.wait(), 60)
        told = await session(server)
        assert not told["loading"] and [one["name"] for one in told["avatars"]] == ["default", "late"]
    async with started(server_of(FakeBackend(), ServerConfig(port=0), later=lambda: [AvatarInfo(name="x")])):
        pass  # stopped while it loads


async def test_a_fault_in_loading_ends_the_wait(caplog):
    def later():
        yield AvatarInfo(name="one")
        raise RuntimeError("a fault")

    async with started(server_of(FakeBackend(), ServerConfig(port=0), later=later)) as server:
        await asyncio.wait_for(server.all_offered.wait(), 60)
        found = await session(server)
    assert [one["name"] for one in found["avatars"]] == ["default", "one"]
    assert "a fault" in caplog.text


def test_each_person_is_offered_but_the_one_who_is_shown_anyway():
    async def main(scene, policy):
        server = assemble(ServedScene(file=SceneFile.of(scene)), ServerConfig(port=0), people=PEOPLE, consent=policy)
        server.drawer.worker = ThreadWorker(FakeBackend())
        async with started(server):
            await asyncio.wait_for(server.all_offered.wait(), 120)
            return await session(server)

    policy = ConsentPolicy()
    policy.add("default", [])
    told = asyncio.run(main(person(PEOPLE[-1]), policy))
    assert [one["name"] for one in told["avatars"]] == ["default", *PEOPLE[:-1]]
    assert all(one["tracking"] and one["head"] and one["height"] > 1.4 for one in told["avatars"][1:])


def test_the_process_that_draws_is_told_names_and_loads_what_is_chosen():
    given = {PEOPLE[0]: default_avatar()}
    avatars = pickle.loads(pickle.dumps(AvatarStore({}, people=PEOPLE)))
    assert len(pickle.dumps(avatars)) < 1000 and list(avatars) == list(PEOPLE) and "nobody" not in avatars
    assert avatars[PEOPLE[1]].skeleton.names == person(PEOPLE[1]).skeleton.names
    assert AvatarStore(given, people=PEOPLE)[PEOPLE[0]] is given[PEOPLE[0]] and len(
        AvatarStore(given, people=PEOPLE)
    ) == len(PEOPLE)


@pytest.mark.parametrize("title", ["<b>x</b>", "a" * 33, 7, None, ["Ann"], "\u202egnp.exe", "", "Ann O'Neil"])
def test_a_title_in_a_file_is_a_name_or_nothing(title):
    avatar = default_avatar()
    found = TrackingOptions().describe("x", replace(avatar, meta=dict(avatar.meta) | {"title": title})).title
    assert found == ("Ann O'Neil" if title == "Ann O'Neil" else "")
