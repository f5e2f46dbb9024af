"""Three members, one hostile: whatever legal messages it sends, the others' pictures come with their labels."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from math import cos, pi, sin, sqrt
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.errors import PoseError
from glsplat.net.backend import AvatarInfo, RenderJob
from glsplat.net.backends.renderer_pool import RendererPool
from glsplat.net.backends.server import offered
from glsplat.net.codec.encode import Encoded
from glsplat.net.local_loop import LocalLoop
from glsplat.net.messages import Decoder, Request, WireOptions
from glsplat.net.options import client_options
from glsplat.net.pace.client_stream import ClientStream
from glsplat.net.poses.answers import Answers
from glsplat.net.reply import Reply, pack_reply, parse_reply
from glsplat.net.rooms.person import FADE, SILENT
from glsplat.net.rooms.room import RoomError
from glsplat.net.rooms.rooms import Rooms
from glsplat.net.rooms.view import VisiblePerson
from glsplat.net.session import Close, Session, SessionConfig, Warn
from glsplat.scene import Rigged, Scene
from glsplat.scenes.scene_file import SceneFile
from tests.net.conftest import FakeBackend
from tests.scene.people import boxes
from tests.scenes import limb

STEPS = 6
SIZE = 32
EYE = {"viewmat": [-1, 0, 0, 0, 0, -1, 0, 1.5, 0, 0, 1, 0.3, 0, 0, 0, 1], "K": [20, 20, 16, 16]}  # ahead, from behind
NAMES = ("Ann", "Bob")


@pytest.fixture(scope="module")
def avatars(somebody: Avatar) -> dict[str, Rigged]:
    """Of the same rig and of another, splats and triangles."""
    return {"person": somebody, "limb": limb(300), "boxes": boxes()}


@pytest.fixture(scope="module")
def offers(avatars: dict[str, Rigged]) -> dict[str, AvatarInfo]:
    return {name: offered(name, avatar, solver="analytic", idle=True) for name, avatar in avatars.items()}


class Drawn:
    """Checks a picture's job up to what a renderer uploads; remembers who was in it."""

    def __init__(self, avatars: dict[str, Rigged]) -> None:
        self.job: RenderJob | None = None
        self.labels: dict[str, Any] = {}  # in the last picture, by text
        self._avatars, self._poses = avatars, dict[int, Any]()
        made: Any = SimpleNamespace(nbytes=dict)  # no renderer
        self._pool = RendererPool(Scene(), avatars, lambda scene: made, {"lab": SceneFile.of(Scene())})

    def __call__(self, job: RenderJob) -> None:
        one = self._pool.of(job)
        one.follow(job, 0.0)
        assert job.room is not None
        for person in job.room.people:
            items = [item for item in one.scene if item.name == person.name]
            assert items and all(item.pose is person.pose for item in items)
            assert any(item.layers for item in items) == (person.opacity > 0)
            if person.pose is not self._poses.get(person.key):
                self._poses[person.key] = person.pose
                self._uploaded(person)
        views = one.views(job)
        assert all(np.isfinite(view.viewmat).all() for view in views)
        words = one.labels(job)
        assert all(np.isfinite(label.place).all() for label in words)
        if (job.frame_id or 0) % 3 == 0:  # which takes as long as all else
            self._pool.write(one, job, np.zeros((len(views), views[0].height, views[0].width, 4), np.uint8))
        self.job, self.labels = job, {label.text: label for label in words}

    def _uploaded(self, person: VisiblePerson) -> None:
        avatar, pose = self._avatars[person.avatar], person.pose
        assert pose is not None and np.isfinite(pose.bones(avatar.skeleton).astype(np.float32)).all()
        weights = avatar.weights(pose) if isinstance(avatar, Avatar) else None
        assert weights is None or np.isfinite(np.asarray(weights, np.float32)).all()


_PICTURE = b"\xff\xd8 a picture"


class RefusedError(Exception):
    """A client is refused a picture or bodies."""


class _Here(Executor):
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        fn(*args, **kwargs)
        return Future()


class Meeting:
    """The room "lab" without sockets. ``draw`` gets each picture's job; tests move ``now``, in seconds."""

    def __init__(self, offers: Mapping[str, AvatarInfo], draw: Callable[[RenderJob], object]) -> None:
        self.now = 100.0
        self.rooms = Rooms({"lab": 6})
        self.ended: list[int] = []  # numbers of clients whose connection the room has ended
        self._offers, self._draw, self._numbers = offers, draw, 0
        self._loop = LocalLoop(FakeBackend(), clock=lambda: self.now)
        self._loop._solve_thread = _Here()  # type: ignore[assignment]
        self._answers = Answers(lambda name: name.encode().ljust(32), lambda name: "", clock=lambda: self.now)

    def enter(self, query: Mapping[str, str]) -> ClientStream:
        """As Server does. Raises ProtocolError."""
        asked = client_options(query, WireOptions(size=(16, 16)), SessionConfig(), list(self._offers))
        one = self._offers[asked.avatar]
        self._numbers += 1
        number = self._numbers
        member = self.rooms.join(asked, one, number, self.now, lambda: self.ended.append(number))
        session = Session(Decoder(asked.wire, one.skeleton, one.parts), asked.session, self.now)
        solver = None if one.solver is None else one.solver(asked.height, asked.span)
        channel = self._loop.open(number, session, solver, "", one, member)
        channel.driver = member.person.name
        if channel.solving is not None:
            channel.solving._cpu = lambda: self.now
        return channel

    def leave(self, channel: ClientStream, goodbye: bool) -> None:
        """Its connection ends, with a close or without."""
        assert channel.member is not None
        self._loop.remove(channel)
        channel.member.end(goodbye)

    def ask(self, channel: ClientStream, message: Mapping[str, Any]) -> Reply | None:
        """What comes back of a message; None for an acknowledgement. Raises RefusedError, PoseError, and for faults."""
        outcome = channel.session.receive(json.dumps(message), self.now)
        if isinstance(outcome, (Warn, Close)):
            raise RefusedError(outcome.text)
        if outcome is None:
            return None
        assert isinstance(outcome, Request)
        self._loop.received(channel, outcome)
        return self._posed(channel) if outcome.poses else self._pictured(channel)

    def _pictured(self, channel: ClientStream) -> Reply:
        frame = self._loop._next_frame(channel)
        request, session = frame.request, channel.session
        try:
            job, _, _ = self._loop._job(frame)
            self._draw(job)
        except BaseException:
            session.failed(request, "", "")
            raise
        pictures = [_PICTURE] * len(request.eyes)
        assert request.frame_id is not None
        data = pack_reply(request.frame_id, request.eyes, pictures, frame.info(Encoded(pictures, None, 0.0)))
        session.sending(request)
        session.sent(request, len(data))
        return parse_reply(data)

    def _posed(self, channel: ClientStream) -> Reply:
        frame = self._answers._answer(channel)
        if frame.poses is None:
            channel.session.failed(frame.request, *frame.error)
            raise RefusedError(*frame.error)
        (data,) = self._answers.pack(frame)
        channel.session.sent(frame.request, len(data))
        return parse_reply(data)


_METRES, _TURNS, _ROOM = 1e6, 20 * pi, 1e4  # limits of poses, of rotations, of tracking and eyes
_KINDS = ("edge", "pose", "joints", "tracking", "tracking", "looks", "legacy", "ack")
_FACE = ("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "nothing", "\U0001f600" * 32)


class Hostile:
    """One sequence of legal messages of numbers at the edges of what is accepted."""

    def __init__(self, chance: Random, joints: Sequence[str]) -> None:
        self._chance, self._joints = chance, joints
        # most sequences are of one kind
        self._kinds = _KINDS if chance.random() < 0.3 else (chance.choice(_KINDS),)
        self._edge = [chance.choice((-1, 1)) if chance.random() < 0.6 else 0 for _ in range(3)]
        self._t = self._number(1e3)
        self._gap = 3.0  # metres to the limit that a pose of the edge keeps

    def message(self, frame_id: int) -> dict[str, Any]:
        chance, kind = self._chance, self._chance.choice(self._kinds)
        if kind == "ack":
            return {"v": 1, "ack": 0}
        if kind == "legacy":
            return self._legacy(frame_id)
        message: dict[str, Any] = {"v": 1, "frame_id": frame_id}
        if kind == "looks" or chance.random() < 0.3:
            message |= self._looks()
        else:
            message["want"] = "pose"
        if chance.random() < 0.8:
            message["t"] = self._time()
        if kind == "tracking":
            message |= {"tracking": self._tracking(), "faces": [self._vector(_ROOM)] * chance.randrange(3)}
        elif chance.random() < 0.9:
            message["pose"] = self._joint_pose() if kind == "joints" else self._pose(kind == "edge")
        return message

    def query(self, name: str) -> dict[str, str]:
        query = {"room": "lab", "name": name}
        if self._chance.random() < 0.5:
            query["at"] = ",".join(str(self._number(limit)) for limit in (100, 100, 360))
        return query

    def _number(self, limit: float) -> float:
        chance = self._chance
        near, small = limit * (1 - 10 ** chance.uniform(-15, -5)), 10 ** chance.uniform(-320, 0)
        value = chance.choice((limit, near, limit * chance.random(), small, chance.uniform(0, 2), 0.0))
        return min(value, limit) * chance.choice((-1, 1))

    def _vector(self, limit: float) -> list[float]:
        return [self._number(limit) for _ in range(3)]

    def _quaternion(self) -> list[float]:
        chance = self._chance
        parts = [chance.gauss(0, 1) for _ in range(4)]
        size = chance.choice((1.0, 1e-8, 900.0)) / sqrt(sum(v * v for v in parts))
        return [v * size for v in parts]

    def _time(self) -> float:
        """Mostly a little later, by very little too; sometimes anything."""
        chance = self._chance
        if chance.random() < 0.85:
            self._t += chance.choice((10 ** chance.uniform(-320, 0), 0.0, *[chance.uniform(1, 60)] * 6))
        else:
            self._t = chance.choice((self._number(1e308), self._number(1e12), -self._t, 0.0))
        return self._t

    def _pose(self, edge: bool) -> dict[str, Any]:
        chance = self._chance
        trans = self._vector(_METRES)
        if edge:  # ever nearer to the limit: what goes on beyond it is not legal any more
            self._gap *= chance.random()
            trans = [side * (_METRES - self._gap) for side in self._edge]
        pose: dict[str, Any] = {"trans": trans}
        if not edge or chance.random() < 0.3:
            pose["root_pose"] = self._vector(_TURNS)
            pose["body_pose"] = [self._number(_TURNS) for _ in range(63)]
        if chance.random() < 0.4:
            pose["expression"] = self._expression()
        return pose

    def _joint_pose(self) -> dict[str, Any]:
        names = self._chance.sample(list(self._joints), min(len(self._joints), 6))
        joints = {name: self._vector(_TURNS) for name in names}
        return {"joints": joints, "translations": {name: self._vector(_METRES) for name in names}} | (
            {"trans": self._vector(_METRES)} if self._chance.random() < 0.7 else {}
        )

    def _expression(self) -> Any:
        if self._chance.random() < 0.3:
            return [self._number(1e308) for _ in range(52)]
        return {name: self._number(1e308) for name in _FACE}

    def _tracking(self) -> dict[str, Any]:
        chance = self._chance
        near = chance.random() < 0.6  # a body that a solver can find, or none

        def device(x: float, y: float) -> list[float]:
            place = [x, y, chance.gauss(0, 0.2)] if near else self._vector(_ROOM)
            return [*place, *self._quaternion()]

        sample: dict[str, Any] = {"head": device(0, 1.6), "left": device(-0.3, 1.1), "right": device(0.3, 1.1)}
        more: dict[str, Callable[[], Any]] = {
            "expression": self._expression,
            "leftEye": lambda: [*self._vector(1e3)[:2], 1e-3],
            "waist": lambda: device(0, 1.0),
            "left_foot": lambda: device(-0.1, 0.1),
            "left_curl": lambda: self._number(1e308),
            "left_joints": lambda: [self._number(_ROOM) for _ in range(75)],
            "body": lambda: {"hips": self._vector(_ROOM), "spine-lower": self._vector(_ROOM)},
        }
        sample |= {name: make() for name, make in more.items() if chance.random() < 0.25}
        for name in list(sample):
            if chance.random() < 0.1:
                sample[name] = None
        return sample

    def _looks(self) -> dict[str, Any]:
        chance = self._chance
        near = chance.choice((1e-6, 0.01, 1.6, 1e9))
        angle, rounding = chance.uniform(-pi, pi), sqrt(1 + 2e-5 * chance.choice((0, 1 - 1e-12, 1 - 1e-11, 0.7, 40)))
        c, s, y = cos(angle) * rounding, sin(angle) * rounding, rounding
        place = self._vector(_ROOM / 2)
        last = [self._number(9e-7), 0, 0, 1 + self._number(9e-7)] if rounding < 1 + 1e-5 else [0, 0, 0, 1]
        viewmat = [c, 0, s, place[0], 0, -y, 0, place[1], s, 0, -c, place[2], *last]
        eye = {"viewmat": viewmat, "K": [chance.choice((2e-3, 40, 9e5)), 40, self._number(9e5), self._number(9e5)]}
        light = {"ambient": [self._vector(1e4) for _ in range(9)]}
        message = {"size": [16, 16], "eyes": [eye | {"near": near, "far": near * 1.5}] * chance.choice((1, 2))}
        wishes = {"light": light, "depth": True, "mirror": True, "alpha": "straight", "crop": True}
        return message | {name: value for name, value in wishes.items() if chance.random() < 0.4}

    def _legacy(self, frame_id: int) -> dict[str, Any]:
        names = ("pos_x", "pos_y", "pos_z", "rot_x", "rot_y", "rot_z", "rot_w")
        head = dict(zip(names, [*self._vector(_ROOM), *self._quaternion()], strict=True))
        return {"frame_id": frame_id, "cameras": [head | {"eye": "left"}], "smplx": self._pose(False)}


class Play:
    """One random sequence."""

    def __init__(self, seed: int, offers: dict[str, AvatarInfo], drawn: Drawn) -> None:
        self.chance = Random(seed)
        self.meeting = Meeting(offers, drawn)
        self.drawn, self.offers = drawn, offers
        self.frame = 0
        self.heard: dict[str, float] = {}
        self.acks = dict.fromkeys(NAMES, 0)
        self.friends = {name: self.meeting.enter({"room": "lab", "name": name}) for name in NAMES}
        self.seats = {name: self.person(one).seat for name, one in self.friends.items()}
        self.eve: ClientStream | None = None
        self.token = ""
        self.said = self.refused = 0  # Eve's messages, and those of them that were refused

    def run(self) -> None:
        for _ in range(STEPS):
            self.meeting.now += self.chance.choice((0.001, 0.02, 0.05, 0.3))
            for name in NAMES:
                self.asks(name)
                for _ in range(self.chance.randrange(3)):
                    self.does_harm()
                    self.meeting.now += self.chance.choice((0.0, 0.004, 0.04))
        for name in NAMES:  # however it ended
            self.asks(name)
        assert set(self.meeting.ended) <= self.eves and not self.meeting._loop.failures

    def asks(self, name: str) -> None:
        self.frame += 1
        channel = self.friends[name]
        place = [self.chance.uniform(-0.2, 0.2), 0.0, self.chance.uniform(-0.1, 0.1)]
        message = {"v": 1, "frame_id": self.frame, "ack": self.acks[name], "t": 1e3 * self.meeting.now}
        pictured = name not in self.heard or self.chance.random() < 0.7  # at first: so that they are in others'
        looks = {"eyes": [EYE, EYE], "size": [SIZE, SIZE], "hide": ["head"], "depth": self.chance.random() < 0.3}
        message |= looks if pictured else {"want": "pose"}
        if self.chance.random() < 0.15:
            message["tracking"] = {"head": [place[0], 1.6, 0, 0, 1, 0, 0]}
        else:
            message["pose"] = {"trans": place}
        reply = self.meeting.ask(channel, message)
        assert reply is not None and reply.frame_id == self.frame
        self.acks[name] = self.frame
        self.heard[name] = self.meeting.now
        if pictured:
            self.sees(name, reply)
        else:
            assert all(body.pose is not None and np.isfinite(body.place).all() for body in reply.bodies)

    def sees(self, name: str, reply: Reply) -> None:
        people = {one["name"]: one for one in reply.info["room"]["people"]}
        assert people[name]["you"] and np.isfinite([one["at"] for one in people.values()]).all()
        assert self.drawn.job is not None and self.drawn.job.room is not None
        shown = {one.name: one for one in self.drawn.job.room.people}
        labels = {f"driven by {one}, synthetic" for one in shown if one != name}
        assert set(self.drawn.labels) == labels and set(shown) == set(people)
        for other in set(self.heard) - {name}:
            one = shown[other]
            assert one.opacity == 1.0 and one.pose is not None
            assert np.allclose(one.transform[:3, 3], self.seats[other][:3, 3])
            head = one.transform[:3, :3] @ (*one.pose.trans[:1], 1.5, *one.pose.trans[2:]) + one.transform[:3, 3]
            assert np.abs(self.drawn.labels[f"driven by {other}, synthetic"].place - head).max() < 1.5
            assert np.abs(one.pose.trans).max() < 1.0  # where they went, and at most 0.3 m ahead of it

    @property
    def eves(self) -> set[int]:
        """Numbers of her connections: all but those of the others."""
        return set(range(1, self.meeting._numbers + 1)) - {one.number for one in self.friends.values()}

    def does_harm(self) -> None:
        roll = self.chance.random()
        if self.eve is None:
            self.comes()
        elif roll < 0.04:
            self.meeting.leave(self.eve, goodbye=self.chance.random() < 0.5)
            self.eve = None
        else:
            self.says()

    def comes(self) -> None:
        avatar = self.chance.choice(list(self.offers))
        self.hostile = Hostile(self.chance, self.offers[avatar].skeleton.names)  # type: ignore[union-attr]
        query = self.hostile.query("Eve") | {"avatar": avatar, "resume": self.token}
        try:
            self.eve = self.meeting.enter(query)
        except RoomError as error:  # a name that is kept for somebody who has no token: herself, without one
            assert error.status == 409 and not self.token
            self.meeting.now += SILENT + FADE
            self.heard.clear()
            return
        self.token = self.person(self.eve).resume if self.chance.random() < 0.7 else ""

    def says(self) -> None:
        self.frame, self.said = self.frame + 1, self.said + 1
        assert self.eve is not None
        try:
            self.meeting.ask(self.eve, self.hostile.message(self.frame))
        except (RefusedError, PoseError):  # all else would be a fault of the server's
            self.refused += 1

    @staticmethod
    def person(channel: ClientStream) -> Any:
        assert channel.member is not None
        return channel.member.person


@pytest.mark.parametrize(
    ("seeds", "refused"), [(range(20), 0.4), pytest.param(range(20, 220), 0.3, marks=pytest.mark.check)], ids=str
)
def test_a_member_fails_nobody_elses_picture(
    seeds: range, refused: float, avatars: dict[str, Rigged], offers: dict[str, AvatarInfo]
) -> None:
    said = no = 0
    for seed in seeds:
        one = Play(seed, offers, Drawn(avatars))
        try:
            one.run()
        except BaseException as error:
            error.add_note(f"sequence {seed}")
            raise
        said, no = said + one.said, no + one.refused
    assert no / said < refused  # of the hostile member's own messages
