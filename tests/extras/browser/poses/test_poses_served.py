"""Poses over the WebSocket, beside a renderer made of numpy."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import aiohttp
import numpy as np
import pytest

from glsplat.errors import ProtocolError
from glsplat.extras.browser.web_format.read import decode_avatar
from glsplat.extras.rooms.feature import Rooms
from glsplat.net.client import Client
from glsplat.net.reply import parse_reply
from glsplat.net.server import Server
from glsplat.rotations import turn_between
from tests.extras.browser.poses.conftest import OFFERS, config, head
from tests.net.conftest import FakeBackend, Serve, eyes
from tests.net.wire import HANG, until

POSE = {"root_pose": [0, 0.4, 0], "trans": [0.5, 0, -1], "expression": {"jawOpen": 0.25, "mine": 1}}


def http(server: Server) -> str:
    return server.url.replace("ws://", "http://").removesuffix("/ws")


def alone(server: Server, avatar: str = "ann", **options: Any) -> Client:
    return Client(f"{server.url}?avatar={avatar}", timeout=HANG, **options)


def member(server: Server, name: str, avatar: str = "ann") -> Client:
    return Client(f"{server.url}?room=lab&name={name}&avatar={avatar}", timeout=HANG)


async def test_a_pose_comes_back_as_it_was_sent_and_nothing_is_drawn(serve: Serve) -> None:
    backend = FakeBackend()
    async with serve(backend, config("ann"), offered=OFFERS) as server, alone(server) as client:
        reply = await client.poses(pose=POSE)
        (body,) = reply.bodies
        assert body.you and body.key == 0 and body.frame_id == reply.frame_id and body.opacity == 1
        assert np.allclose(body.pose.trans, (0.5, 0, -1)) and np.allclose(body.place, np.eye(4))
        turned = np.zeros((55, 3))
        turned[0, 1] = 0.4
        assert np.abs(turn_between(turned, body.pose.rotations)).max() < 1e-4
        assert dict(body.pose.expression) == {"jawOpen": 64 / 255}  # as near as a byte comes; "mine" is not ARKit's
        assert reply.nbytes < 1000 and not reply.pictures and reply.info["want"] == "pose"
        solved = await client.poses(tracking=head(0.75))
        (body,) = solved.bodies
        assert body.pose.trans[0] == 0.75 and solved.info["tracking"] == ["left_lost"]
        assert np.allclose(body.place, np.diag([1.25, 1.25, 1.25, 1]) + np.eye(4, k=2) * [[0], [0.5], [0], [0]])
        assert set(solved.info["times"]) == {"ik", "wait", "total"}
        assert not (await client.poses()).bodies[0].pose.rotations.any()  # the rest pose
        assert not backend.drawn
        assert server.stats()["totals"]["posed"] == 3


async def test_the_file_is_fetched_by_its_hash_and_kept(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann"), offered=OFFERS) as server:
        async with aiohttp.ClientSession() as web, alone(server) as client:
            async with web.get(f"{http(server)}/session") as answer:
                avatars = {one["name"]: one["hand_out"] for one in (await answer.json())["avatars"]}
            assert avatars["bob"] is None and avatars["scenery"] is None
            found = avatars["ann"]
            async with web.get(f"{http(server)}/{found['url']}") as answer:
                data = await answer.read()
                assert answer.status == 200 and len(data) == found["bytes"] == found["first"]
                assert {"immutable", "private"} <= {*answer.headers["Cache-Control"].split(", ")}
                etag = answer.headers["ETag"]
            assert len(decode_avatar(data).splats) == 40
            async with web.get(f"{http(server)}/{found['url']}", headers={"If-None-Match": etag}) as answer:
                assert answer.status == 304
            (body,) = (await client.poses()).bodies
            assert body.sha256 == found["sha256"]
            for path in ("0" * 64, found["sha256"][:-1], found["sha256"].upper(), "..%2f..%2fsession"):
                async with web.get(f"{http(server)}/splats/{path}") as answer:
                    assert answer.status == 404 and (await answer.text()).count("\n") == 1, path


async def test_who_is_not_handed_out_is_drawn_here(serve: Serve) -> None:
    """Neither file nor pose, also once the consent ends; pictures go on."""
    settings = config("ann")
    assert settings.consent is not None
    async with serve(FakeBackend(), settings, offered=OFFERS) as server, aiohttp.ClientSession() as web:
        for name in ("bob", "scenery"):
            async with alone(server, name) as client:
                for _ in range(10):  # it is no malformed message
                    with pytest.raises(ProtocolError) as error:
                        await client.poses()
                    assert error.value.code == "no_pose"
                assert (await client.render(eyes())).pictures
        async with alone(server) as client:
            digest = (await client.poses()).bodies[0].sha256
            settings.consent.add("ann", settings.consent._people["bob"])
            with pytest.raises(ProtocolError, match="no consent on file"):
                await client.poses()
            async with web.get(f"{http(server)}/splats/{digest}") as answer:
                assert answer.status == 403 and "no consent on file" in await answer.text()
            assert (await client.render(eyes())).pictures
    async with serve(FakeBackend(), offered=OFFERS) as server, alone(server) as client:  # without consent files
        with pytest.raises(ProtocolError, match="hands out no splats"):
            await client.poses()
        assert all(one["hand_out"] is None for one in server.session()["avatars"])


async def test_in_a_room_each_is_told_what_is_news_to_them(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann"), offered=OFFERS) as server:
        async with member(server, "Ann") as ann, member(server, "Cat") as cat, member(server, "Bob", "bob") as bob:
            first = await ann.poses(tracking=head(0.1, expression={"cheekPuff": 1}))
            room = first.info["room"]
            assert [(one["name"], one["you"], one["sha256"] is None) for one in room["people"]] == [
                ("Ann", True, False),
                ("Cat", False, False),
                ("Bob", False, True),
            ]
            assert room["people"][1]["label"] == "driven by Cat, synthetic" and len(room["place"]) == 7
            assert [body.you for body in first.bodies] == [True]  # of the others nothing has come
            await bob.render(eyes(), tracking=head(0.2))  # who is drawn by the server, and draws nobody
            await cat.poses(tracking=head(0.3))
            second = await ann.poses(tracking=head(0.4))
            assert "room" not in second.info
            keys = {one["name"]: one["key"] for one in room["people"]}
            stands = {body.key: body for body in second.bodies}
            assert set(stands) == {keys["Ann"], keys["Cat"]}
            seen = stands[keys["Cat"]]
            assert not seen.you and abs(seen.pose.trans[0] - 0.3) < 1e-6
            assert abs(stands[keys["Ann"]].pose.trans[0] - 0.4) < 1e-6
            person = server.clients[2].member.person  # type: ignore[union-attr]
            seat = person.place(person.newest)[1]  # type: ignore[arg-type]
            assert np.allclose(seen.place, seat, atol=1e-6)
            (own,) = (await ann.poses(tracking=head(0.5))).bodies  # nobody else has moved
            assert own.you
            picture = await bob.render(eyes(), tracking=head(0.6))  # sees those who draw themselves
            assert [one["name"] for one in picture.info["room"]["people"]] == ["Ann", "Cat", "Bob"]


async def test_who_leaves_is_gone_and_who_is_silent_fades(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann"), offered=OFFERS) as server, member(server, "Ann") as ann:
        async with member(server, "Cat") as cat:
            counts = []
            for _ in range(3):
                await cat.poses()  # who only listens is news once
                counts.append(len((await ann.poses(tracking=head())).bodies))
            assert counts == [2, 1, 1]
            await cat.poses(tracking=head(0.3))
            person = server.clients[2].member.person  # type: ignore[union-attr]
            person._last_seen -= 2.25
            await asyncio.sleep(0.04)  # a room looks now and then who is silent
            bodies = {body.you: body for body in (await ann.poses(tracking=head())).bodies}
            assert 0.3 < bodies[False].opacity < 0.6
        await until(lambda: len(server.clients) == 1)
        reply = await ann.poses(tracking=head())
        assert [one["name"] for one in reply.info["room"]["people"]] == ["Ann"]
        assert [body.you for body in reply.bodies] == [True]
        room = server.feature(Rooms)._rooms["lab"]
        await ann.close()
        await until(lambda: not server.clients)
        assert not room._guests and not room._changes


async def test_a_busy_renderer_holds_no_pose_back(serve: Serve) -> None:
    backend = FakeBackend()
    async with serve(backend, config("ann"), offered=OFFERS) as server, alone(server) as one, alone(server) as two:
        backend.gate.clear()
        waiting = asyncio.create_task(two.render(eyes()))
        await until(lambda: backend.drawn)
        for x in range(5):
            assert (await one.poses(tracking=head(x))).bodies[0].pose.trans[0] == x
        assert not waiting.done()
        backend.gate.set()
        assert (await waiting).pictures


WRONG = [
    ({"frame_id": 1, "want": "film"}, "bad_request"),
    ({"frame_id": 1, "want": ["pose"]}, "bad_field"),
    ({"ack": 0, "want": "pose"}, "bad_request"),
    ({"frame_id": 1, "want": "pose", "pose": {"body_pose": [1]}}, "bad_pose"),
    ({"frame_id": 1, "want": "pose", "pose": POSE, "tracking": {}}, "bad_request"),
    ({"frame_id": 1, "want": "pose", "tracking": {"head": [1, 2]}}, "bad_request"),
    ({"frame_id": 1, "want": "pose", "tracking": {"left_curl": 1}}, "bad_pose"),
]


async def test_what_is_wrong_is_said_and_costs_that_message(serve: Serve) -> None:
    async with serve(FakeBackend(), config("ann"), offered=OFFERS) as server, aiohttp.ClientSession() as web:
        for message, code in WRONG:
            async with web.ws_connect(f"{server.url}?avatar=ann") as ws:
                await ws.send_str(json.dumps({"v": 1, **message}))
                assert json.loads((await ws.receive(timeout=HANG)).data)["error"]["code"] == code, message
                await ws.send_str(json.dumps({"v": 1, "frame_id": 9, "want": "pose"}))
                assert len(parse_reply((await ws.receive(timeout=HANG)).data).bodies) == 1
