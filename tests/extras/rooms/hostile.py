"""A hostile member of a room: legal messages of numbers at the edges of what is accepted, in random order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, pi, sin, sqrt
from random import Random
from typing import Any

__all__ = ["Hostile"]

_METRES, _TURNS, _ROOM = 1e6, 20 * pi, 1e4  # limits of poses, of rotations, of tracking and eyes
_KINDS = ("edge", "pose", "joints", "tracking", "tracking", "looks", "legacy", "ack")
_FACE = ("jawOpen", "eyeBlinkLeft", "mouthSmileRight", "nothing", "\U0001f600" * 32)


class Hostile:
    """One sequence's messages. ``joints`` are the names of the avatar's joints."""

    def __init__(self, chance: Random, joints: Sequence[str]) -> None:
        self._chance, self._joints = chance, joints
        # most sequences are of one kind: two messages that go together come soon after each other
        self._kinds = _KINDS if chance.random() < 0.3 else (chance.choice(_KINDS),)
        self._edge = [chance.choice((-1, 1)) if chance.random() < 0.6 else 0 for _ in range(3)]
        self._t = self._number(1e3)
        self._gap = 3.0  # metres to the limit that a pose of the edge keeps

    def message(self, frame_id: int) -> dict[str, Any]:
        """The next one."""
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
        """Of an address by which it comes in."""
        query = {"room": "lab", "name": name}
        if self._chance.random() < 0.5:
            query["at"] = ",".join(str(self._number(limit)) for limit in (100, 100, 360))
        return query

    def _number(self, limit: float) -> float:
        chance = self._chance
        kind = chance.randrange(6)
        if kind == 0:
            value = limit
        elif kind == 1:
            value = limit * (1 - 10 ** chance.uniform(-15, -5))
        elif kind == 2:
            value = limit * chance.random()
        elif kind == 3:
            value = 10 ** chance.uniform(-320, 0)
        else:
            value = chance.uniform(0, 2) if kind == 4 else 0.0
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
        """Eyes, light and more of one's own picture."""
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
