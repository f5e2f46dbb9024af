"""Pictures that go wrong because of others in them: the viewer is sent one without those."""

from __future__ import annotations

import aiohttp
import numpy as np
import pytest

from glsplat.camera import head_matrix, stereo_cameras
from glsplat.errors import BudgetError, ContextError, ContextLostError, GlsplatError, ProtocolError
from glsplat.net.backend import AvatarInfo, RenderJob
from glsplat.net.client import Client
from glsplat.net.guard.fault_tracker import FaultTracker
from glsplat.net.rooms import person
from glsplat.net.server import Server, ServerConfig
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES
from tests.net.conftest import FakeBackend, Serve
from tests.net.loops import in_a_loop
from tests.net.rooms.conftest import Hands
from tests.net.workers.fakes import GUARD, camera, pool
from tests.net.workers.sleeper import Fragile

EYES = stereo_cameras(head_matrix((0, 1.6, 0), (0, 1, 0, 0)), size=(32, 32))
RIG = Skeleton.from_joints(JOINT_NAMES, [-1] + [0] * 54, np.zeros((55, 3)))
OFFERS = (AvatarInfo(name="ann", skeleton=RIG, parts=frozenset(["head"])),)
POSE = {"root_pose": [0, 0.1, 0]}
CONFIG = ServerConfig(port=0, rooms={"lab": 4})
SLOW = BudgetError("the picture took more than 5 s", "too_slow")


def member(server: Server, name: str) -> Client:
    return Client(f"{server.url}?room=lab&name={name}", timeout=GUARD)


def shows_eve(job: RenderJob) -> bool:
    assert job.room is not None
    return bool(job.others) and any(p.name == "eve" and p.key != job.room.viewer for p in job.room.people)


@pytest.fixture(autouse=True)
def _here(nobody_fades: None) -> None:
    """However long it takes."""


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
@in_a_loop
async def test_a_viewer_gets_pictures_whatever_anothers_splats_do(
    serve: Serve, hands: Hands, error: Exception, shares: set[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty minutes: no error, nobody held off; in between others are shown again."""
    monkeypatch.setattr(person, "SILENT", 1e9)  # Eve, who asks once, fades on no machine, however slow
    backend = FakeBackend(fail=lambda job: error if shows_eve(job) and job.others > 0.25 else None)
    async with (
        serve(backend, CONFIG, offered=OFFERS) as server,
        member(server, "eve") as eve,
        member(server, "ann") as ann,
    ):
        server.render_loop._clock = hands  # type: ignore[union-attr]
        assert await asks(eve, 1) == [""]
        backend.drawn.clear()
        answers = []
        for _ in range(150):
            hands.now += 8
            answers += await asks(ann, 1)
        others = [job.others for job in backend.drawn]
        async with aiohttp.ClientSession() as http, http.get(f"http://127.0.0.1:{server.port}/session") as response:
            status = response.status
    assert answers == [""] * 150 and status == 200
    assert 7 <= others.count(1.0) <= 10  # after 10, 20, 40 ... 300 s
    tried = [i for i, share in enumerate(others) if share == 1.0]
    assert all(others[i + 1] == 0.0 for i in tried)  # at once, for the same request
    assert {share for i, share in enumerate(others) if share != 1.0 and i - 1 not in tried} == shares


@in_a_loop
async def test_a_worker_that_does_not_survive_another_person_is_no_viewers_fault(serve: Serve) -> None:
    """Each picture comes, drawn by the next worker without the others."""
    async with serve(pool(makes=[Fragile, Fragile]), CONFIG, offered=OFFERS) as server:
        async with member(server, "eve") as eve, member(server, "ann") as ann:
            await eve.render([camera(1)], pose=POSE)
            assert sorted(one["clients"] for one in server.render_loop.workers()) == [0, 2]
            frames = [(await ann.render([camera(2)], pose=POSE)).frame_id for _ in range(6)]
            await eve.render([camera(1)], pose=POSE)
            assert frames == [1, 2, 3, 4, 5, 6] and server.render_loop.rebuilds == 1


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
