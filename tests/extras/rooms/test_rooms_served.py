"""Rooms over the WebSocket, on a renderer made of numpy; and pictures that go wrong because of others in them."""

from __future__ import annotations

from typing import Any

import aiohttp
import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import BudgetError, ContextError, ContextLostError, GlsplatError, ProtocolError
from glsplat.extras.rooms import person
from glsplat.extras.rooms.person import FADE_S, SILENT_S
from glsplat.net.backend import AvatarInfo, Rendered, RenderJob, Solved
from glsplat.net.client import Client
from glsplat.net.guard.addresses import FaultTracker
from glsplat.net.messages import Request
from glsplat.net.server import Server, ServerConfig
from glsplat.net.session import SessionConfig
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.extras.workers.fakes import GUARD, camera, pool, until
from tests.extras.workers.sleeper import Fragile
from tests.net.clocks import Stopped
from tests.net.conftest import FakeBackend, Serve

EYES = stereo_cameras(head_matrix((0, 1.6, 0), (0, 1, 0, 0)), size=(32, 32))
RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))
POSE = {"root_pose": [0, 0.1, 0]}


class Solver:
    """Puts the head's x into the root."""

    def solve(self, request: Request, now: float) -> Solved:
        assert request.tracking is not None
        return Solved(Pose(np.zeros((55, 3)), (request.tracking.head[0], 0, 0)), scale=2.0)


OFFERS = (
    AvatarInfo(name="ann", skeleton=RIG, solver=lambda height, span: Solver(), parts=frozenset(["head"])),
    AvatarInfo(name="scenery"),
)


def config(**changes: Any) -> ServerConfig:
    return ServerConfig(port=0, rooms={"lab": 4, "small": 1}, **changes)


def member(server: Server, name: str, room: str = "lab", **options: Any) -> Client:
    return Client(f"{server.url}?room={room}&name={name}", timeout=GUARD, **options)


async def test_each_sees_the_others_and_is_named(serve: Serve) -> None:
    backend = FakeBackend()
    async with serve(backend, config(), offered=OFFERS) as server:
        async with member(server, "Ann") as ann, member(server, "Bob") as bob:
            await ann.render(EYES, pose=POSE)
            reply = await bob.render(EYES, tracking={"head": [0.25, 1.6, 0, 0, 0, 0, 1]}, hide=["head"])
            room = reply.info["room"]
            assert room["name"] == "lab" and room["people"][1]["frame_id"] == reply.frame_id
            assert [(p["name"], p["you"]) for p in room["people"]] == [("Ann", False), ("Bob", True)]
            # each in Bob's own space: Ann on the other side, he where twice his avatar's x is
            assert [p["at"] for p in room["people"]] == [
                pytest.approx([0, 0, 2.4], abs=2e-3),
                pytest.approx([0.5, 0, 0], abs=2e-3),
            ]
            drawn = backend.drawn[-1]
            assert drawn.room is not None and drawn.options.hide == ("head",)
            bobs = drawn.room.people[1]
            assert bobs.pose is not None and bobs.pose.trans[0] == 0.25
            assert room["people"][1]["label"] == "driven by Bob, synthetic"
            assert np.allclose(np.linalg.det(bobs.transform[:3, :3]), 8)  # twice his avatar's size
            # his own eyes, from his own place
            assert np.allclose(drawn.cameras[0].viewmat @ server.clients[2].member.person.seat, EYES[0].viewmat)  # type: ignore[union-attr]


async def test_the_way_in(serve: Serve) -> None:
    async with serve(FakeBackend(), config(), offered=OFFERS) as server:
        async with member(server, "Ann") as ann, member(server, "Ann", "small"):
            await ann.render(EYES, pose=POSE)
            refused = {
                "room=lab&name=Ann": 409,
                "room=small&name=Bob": 503,
                "room=../lab&name=Bob": 404,
                "room=lab&name=": 400,
                "room=lab&name=Bob&avatar=scenery": 400,
                "room=lab&name=Bob&at=nowhere": 400,
            }
            for query, status in refused.items():
                with pytest.raises(ProtocolError, match=rf"\({status}\)"):
                    await Client(f"{server.url}?{query}").connect()
            assert server.session()["rooms"] == [
                {"name": "lab", "people": 1, "seats": 4, "scene": False},
                {"name": "small", "people": 1, "seats": 1, "scene": False},
            ]
            assert len(server.clients) == 2
        # without a name one is given, with a goodbye one goes at once
        async with Client(f"{server.url}?room=small") as guest:
            await guest.render(EYES, pose=POSE)
            (person,) = server.stats()["rooms"][1]["people"]
            assert person["name"].startswith("guest ")
        assert await until(lambda: server.stats()["rooms"][1]["people"] == [])


async def test_a_lost_connection_fades_and_may_come_back(serve: Serve, stopped: Stopped) -> None:
    async with serve(FakeBackend(), config(), offered=OFFERS) as server, member(server, "Ann") as ann:
        bob = member(server, "Bob")
        for silence, opacity in ((0.0, 1.0), (SILENT_S + FADE_S / 4, 0.75), (SILENT_S + FADE_S, None)):
            await bob.connect()  # under the same name
            await bob.render(EYES, pose=POSE)
            bob._connection._ws._writer.transport.abort()  # type: ignore[union-attr]
            assert await until(lambda: len(server.clients) == 1)
            await bob.close()
            stopped.now += silence
            people = {p["name"]: p["opacity"] for p in (await ann.render(EYES, pose=POSE)).info["room"]["people"]}
            assert people.get("Bob") == (opacity and pytest.approx(opacity, abs=0.01)) and people["Ann"] == 1.0


@pytest.mark.parametrize("name", ["&name=Ann", ""])
async def test_a_token_brings_its_person_back_at_once(serve: Serve, name: str) -> None:
    """And closes the other connection."""
    async with serve(FakeBackend(), config(), offered=OFFERS) as server:
        url = f"{server.url}?room=lab{name}"
        async with member(server, "Bob"), Client(f"{url}&at=1,2,90") as first:
            room = (await first.poses(pose=POSE)).info["room"]
            (own,) = (one for one in room["people"] if one["you"])
            async with Client(f"{url}&resume={room['resume']}") as again:
                now = (await again.render(EYES, pose=POSE)).info["room"]
                assert [one["name"] for one in now["people"] if one["you"]] == [own["name"]]
                assert now["resume"] == room["resume"]
                seats = [stream.member.person.seat for stream in server.clients.values() if stream.member]
                assert np.allclose(seats[-1][:3, 3], (1, 0, 2))
                with pytest.raises(ProtocolError, match="1001"):
                    while True:
                        await first.render(EYES, pose=POSE)
                assert await until(lambda: len(server.clients) == 2)
                await again.render(EYES, pose=POSE)  # the end of the old connection is not that of the new one
        assert await until(lambda: server.stats()["rooms"][0]["people"] == [])
        async with Client(f"{url}&resume={room['resume']}") as late:  # a token of somebody who is gone
            assert (await late.render(EYES, pose=POSE)).info["room"]["resume"] != room["resume"]


async def test_pictures_say_nothing_of_rooms_to_who_is_in_none(serve: Serve) -> None:
    async with serve(FakeBackend(), config(), offered=OFFERS) as server, Client(server.url) as client:
        assert "room" not in (await client.render(EYES, pose=POSE)).info
    async with serve(FakeBackend(), ServerConfig(port=0), offered=OFFERS) as server:
        assert server.session()["rooms"] == [] and server.stats()["rooms"] == []
        with pytest.raises(ProtocolError, match="no such room"):
            await member(server, "Ann").connect()


SLOW = BudgetError("the picture took more than 5 s", "too_slow")


def shows_eve(job: RenderJob) -> bool:
    assert job.room is not None
    return bool(job.others) and any(p.name == "eve" and p.key != job.room.viewer for p in job.room.people)


async def asks(client: Client, count: int) -> list[str]:
    """Return the answer to each request: "" for a picture, else the error's code."""
    answers = []
    for _ in range(count):
        try:
            await client.render(EYES, pose=POSE, hide=["head"])
            answers.append("")
        except ProtocolError as error:
            answers.append(error.code)
            if error.code == "closed":
                break
    return answers


@pytest.mark.parametrize(
    ("error", "shares"),
    [
        (SLOW, {0.25, 0.0}),
        (ContextLostError("the context is lost"), {0.0}),
        (ContextError("9000000 splats need larger textures"), {0.0}),
        (GlsplatError("an OpenGL error"), {0.0}),
        (ZeroDivisionError("a fault of the renderer's"), {0.0}),
    ],
)
@pytest.mark.usefixtures("nobody_fades")
async def test_a_viewer_gets_pictures_whatever_anothers_splats_do(
    serve: Serve, stopped: Stopped, error: Exception, shares: set[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty minutes: no error, nobody held off; in between others are shown again."""
    monkeypatch.setattr(person, "SILENT_S", 1e9)  # Eve, who asks once, fades on no machine, however slow
    backend = FakeBackend(fail=lambda job: error if shows_eve(job) and job.others > 0.25 else None)
    async with (
        serve(backend, config(), offered=OFFERS) as server,
        member(server, "eve") as eve,
        member(server, "ann") as ann,
    ):
        assert await asks(eve, 1) == [""]
        backend.drawn.clear()
        answers = []
        for _ in range(150):
            stopped.now += 8
            answers += await asks(ann, 1)
        others = [job.others for job in backend.drawn]
        async with aiohttp.ClientSession() as http, http.get(f"http://127.0.0.1:{server.port}/session") as response:
            status = response.status
    assert answers == [""] * 150 and status == 200
    assert 7 <= others.count(1.0) <= 10  # after 10, 20, 40 ... 300 s
    tried = [i for i, share in enumerate(others) if share == 1.0]
    assert all(others[i + 1] == 0.0 for i in tried)  # at once, for the same request
    assert {share for i, share in enumerate(others) if share != 1.0 and i - 1 not in tried} == shares


@pytest.mark.usefixtures("nobody_fades")
@pytest.mark.parametrize(
    ("error", "code", "warned"),
    [
        (SLOW, "too_slow", 1),
        (ContextLostError("lost"), "render", 1),
        (BudgetError("1e12 pixels", "too_costly"), "too_costly", 8),
    ],
)
async def test_what_goes_wrong_without_the_others_is_the_viewers_own(
    serve: Serve, error: Exception, code: str, warned: int
) -> None:
    """Warnings, then the end, and the address is held off; the others are not left out for too much cost."""
    backend = FakeBackend(fail=lambda job: error if job.room is not None and job.room.viewer == 2 else None)
    async with serve(backend, config(), offered=OFFERS) as server, member(server, "ann") as ann:
        assert await asks(ann, 1) == [""]
        async with member(server, "eve") as eve:
            assert await asks(eve, warned + 2) == [code] * (warned + 1) + ["closed"]
        async with aiohttp.ClientSession() as http, http.get(f"http://127.0.0.1:{server.port}/session") as response:
            assert response.status in (429, 503)
    others = [job.others for job in backend.drawn if job.room is not None and job.room.viewer == 2]
    assert others.count(1.0) == (warned + 1 if code == "too_costly" else 1) and len(others) <= warned + 3


@pytest.mark.usefixtures("nobody_fades")
async def test_a_worker_that_does_not_survive_another_person_is_no_viewers_fault(serve: Serve) -> None:
    """Each picture comes, drawn by the next worker without the others."""
    async with serve(pool(makes=[Fragile, Fragile]), config(), offered=OFFERS) as server:
        async with member(server, "eve") as eve, member(server, "ann") as ann:
            await eve.render([camera(1)], pose=POSE)
            assert sorted(one["clients"] for one in server.drawer.workers()) == [0, 2]
            frames = [(await ann.render([camera(2)], pose=POSE)).frame_id for _ in range(6)]
            await eve.render([camera(1)], pose=POSE)
            assert frames == [1, 2, 3, 4, 5, 6] and server.drawer.rebuilds == 1


def test_others_are_suspected_for_longer_each_time() -> None:
    tracker, now = FaultTracker(), 1000.0
    assert tracker.others("a", now) == 1.0
    for number, seconds in enumerate((10, 20, 40, 80, 160, 300, 300)):
        tracker.suspect_others("a", now, slow=True)
        assert tracker.others("a", now + seconds - 0.1) == (0.25 if number == 0 else 0.0)
        assert tracker.others("a", now + seconds) == 1.0 == tracker.others("b", now)
        assert not tracker.suspects("a", now)  # the viewer is not
        now += seconds
    tracker.suspect_others("a", now + 1e4, slow=False)
    assert tracker.others("a", now + 1e4) == 0.0
    assert tracker.others("a", now + 1e4 + 10) == 1.0  # all of it was forgotten


def test_the_second_bad_picture_of_an_address_is_one_too_many() -> None:
    blame = FaultTracker()
    assert [blame.again("a", 0.0), blame.again("b", 1.0), blame.again("a", 2.0)] == [False, False, True]
    assert not blame.again("b", 1000.0)  # forgotten
    for i in range(10000):
        assert not blame.again(f"c{i}", 1001.0)
    assert len(blame._last) <= 4096


@pytest.mark.parametrize(("seconds", "adapt", "reduced"), [(0.1, True, False), (0.3, True, True), (0.3, False, False)])
async def test_members_get_six_pictures_a_second_at_less_detail(
    serve: Serve, stopped: Stopped, seconds: float, adapt: bool, reduced: bool
) -> None:
    """Unless pictures are fixed."""

    class Slow(FakeBackend):
        def render(self, request: RenderJob) -> Rendered:
            stopped.now += seconds
            return super().render(request)

    async with serve(Slow(), config(session=SessionConfig(adapt=adapt)), offered=OFFERS) as server:
        async with member(server, "Ann") as ann:
            infos = [(await ann.render(EYES, pose=POSE)).info for _ in range(12)]
    assert ("detail" in infos[-1]) == reduced
    assert "detail" not in infos[0]
