"""The network beside the samples: run at its own rate, read at any moment, in the world and without jumps."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, exp, hypot

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.learned.frames import TICK, Guess, TrackedFrames, inputs_of, slower, unit_of
from glsplat.extras.learned.network import PoseNetwork
from glsplat.rotations import quaternion_matrices
from glsplat.tracking.solve.body import ANKLES, FEET, Body
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    add,
    from_axes,
    length,
    mul,
    nlerp,
    pull,
    rotate,
    slerp,
    sub,
    swing_twist_y,
    yaw_quat,
)
from glsplat.tracking.solve.solution import Targets

__all__ = ["FootHint", "Hint", "Hints"]

Array = NDArray[np.float32]

TORSO = (0.024, 0.024, 0.024)  # seconds: low passes, one after the other, by which torso and knees take up a guess
JUMP = 0.04  # seconds in which a foot's goal takes up what a tick says otherwise than the one before
NEVER = 1e-6


@dataclass(slots=True)
class FootHint:
    """One foot, in the world."""

    ball: Vec  # where it should be
    speed: Vec  # m/s
    yaw: float  # radians
    pitch: float  # radians, the heel up
    stance: float  # 0 in the air .. 1 on the ground
    confidence: float  # 0 .. 1: whether feet go where they were predicted to go
    knee: Vec  # position of the knee


@dataclass(slots=True)
class Hint:
    """What the network says of this moment, in the world."""

    pelvis_at: Vec
    pelvis: Quat
    chest: Quat
    feet: tuple[FootHint, FootHint]


@dataclass(slots=True)
class _Said:
    """A guess as plain numbers, in the world; a glance aside turns the head, not what was said of the body."""

    pelvis: Quat
    chest: Quat
    pelvis_at: Vec  # from the eyes
    knees: tuple[Vec, Vec]
    now: tuple[Vec, Vec, Vec, Vec]  # ankles, feet
    ahead: tuple[Vec, Vec, Vec, Vec]  # one tick later
    stands: tuple[float, float]


_Pose = tuple[Quat, Quat, Vec, Vec, Vec, float, float]
"""Pelvis, chest, the pelvis' place, knees, how surely feet stand; from the head."""


def _towards(a: _Pose, b: _Pose, k: float) -> _Pose:
    return (
        nlerp(a[0], b[0], k),
        nlerp(a[1], b[1], k),
        pull(a[2], b[2], k),
        pull(a[3], b[3], k),
        pull(a[4], b[4], k),
        a[5] + (b[5] - a[5]) * k,
        a[6] + (b[6] - a[6]) * k,
    )


class Hints:
    """Ticks of the network under samples of any rate: 30, 72 and 90 Hz give it the same moments.

    A tick sees the targets as they were at its time, interpolated between two samples. Between ticks feet go on towards
    where the network says they will be at the next one.
    """

    def __init__(self, body: Body, network: PoseNetwork) -> None:
        self.network = network
        self.unit: float = unit_of(body.eye_height)
        # how a foot lies at rest: its heading and slope from ankle to ball
        lines = [np.subtract(body.joints[FEET[i]], body.joints[ANKLES[i]]) for i in (0, 1)]
        self.rest: list[tuple[float, float]] = [(atan2(v[0], v[2]), atan2(-v[1], hypot(v[0], v[2]))) for v in lines]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.state: Array = self.network.start()
        self._last: tuple[Targets, float] | None = None  # newest sample and its heading
        self._before: TrackedFrames | None = None  # of the last tick
        self._means: Array = np.zeros((1, 3, 2), np.float32)
        self._since = 0.0  # seconds from the last tick to the newest sample
        self._said: _Said | None = None
        self._steps, self._misses = [0.0, 0.0], [0.0, 0.0]  # metres a tick, smoothed: as said, and beside that
        self._off: list[Vec] = [(0.0, 0.0, 0.0)] * 4  # what is shown of the feet, less what is said; fades
        self._stages: list[_Pose] = []  # what the low passes hold

    def update(self, targets: Targets, dt: float) -> Hint:
        """The hint for these targets, ``dt`` seconds after the last ones."""
        seen = swing_twist_y(targets.head)
        yaw = self._last[1] if seen is None and self._last else (seen or 0.0)
        if self._last is None:
            self._tick(targets, yaw)
        else:
            before, turned = self._last
            self._since += dt
            while self._since >= TICK - NEVER:
                self._since = max(self._since - TICK, 0.0)
                part = 1 - self._since / dt if dt > 0 else 1.0
                if part >= 1 - 1e-6:
                    self._tick(targets, yaw)
                else:
                    between = _between(before, targets, max(part, 0.0))
                    seen = swing_twist_y(between.head)
                    self._tick(between, turned if seen is None else seen)
        self._last = (targets, yaw)
        return self._hint(targets, dt)

    def _tick(self, targets: Targets, yaw: float) -> None:
        now = _seen(targets, yaw)
        if self._before is None:
            self._before = now
            self._means = np.repeat(now.eye[:, None, [0, 2]], 3, 1)
        self._means = slower(self._means, now.eye)
        numbers, self.state = self.network.step(inputs_of(now, self._before, self._means, self.unit)[0], self.state)
        self._before = now
        old, self._said = self._said, _plain(Guess.of(numbers[None], self.unit), targets.eye, yaw)
        if old is not None:
            said = self._said
            self._off = [sub(add(a, o), n) for a, o, n in zip(old.ahead, self._off, said.now, strict=True)]
            for side in (0, 1):
                self._trusted(side, old, said)

    def _trusted(self, side: int, old: _Said, new: _Said) -> None:
        """How far a foot has gone where the tick before said it would go; far from what it knows the network dreams."""
        was, said, now = old.now[side + 2], old.ahead[side + 2], new.now[side + 2]
        step, miss = self._steps[side], self._misses[side]
        self._steps[side] = step + 0.3 * (length(sub(said, was)) - step)
        self._misses[side] = miss + 0.3 * (length(sub(now, said)) - miss)

    def _hint(self, targets: Targets, dt: float) -> Hint:
        said = self._said
        assert said is not None
        part = min(self._since / TICK, 1.0)
        k = exp(-dt / JUMP)
        self._off = [(x * k, y * k, z * k) for x, y, z in self._off]
        ankles_feet = [add(pull(a, b, part), off) for a, b, off in zip(said.now, said.ahead, self._off, strict=True)]
        pose: _Pose = (said.pelvis, said.chest, said.pelvis_at, *said.knees, *said.stands)
        if not self._stages:
            self._stages = [pose] * len(TORSO)
        for i, tau in enumerate(TORSO):
            self._stages[i] = pose = _towards(self._stages[i], pose, 1 - exp(-dt / tau))
        pelvis, chest, at, left, right, *_ = pose
        stands = self._stages[1][5:]  # a foot that waits for the torso is late
        knees = (left, right)
        eye = targets.eye
        feet = []
        for side in (0, 1):
            ankle, ball = ankles_feet[side], ankles_feet[side + 2]
            x, y, z = sub(ball, ankle)
            rest_yaw, rest_slope = self.rest[side]
            trust = 1.3 * (1 - self._misses[side] / max(self._steps[side], 1e-3))
            speed = sub(said.ahead[side + 2], said.now[side + 2])
            feet.append(
                FootHint(
                    ball,
                    (speed[0] / TICK, speed[1] / TICK, speed[2] / TICK),
                    atan2(x, z) - rest_yaw,
                    atan2(-y, max(hypot(x, z), 1e-6)) - rest_slope,
                    stands[side],
                    max(0.0, min(1.0, trust)),
                    add(eye, knees[side]),
                )
            )
        return Hint(add(eye, at), pelvis, chest, (feet[0], feet[1]))


def _between(a: Targets, b: Targets, part: float) -> Targets:
    """Targets between two samples; a hand counts as seen where both see it."""
    out = Targets(pull(a.eye, b.eye, part), slerp(a.head, b.head, part))
    if a.left is not None and b.left is not None:
        out.left, out.left_hand = pull(a.left, b.left, part), slerp(a.left_hand, b.left_hand, part)
    if a.right is not None and b.right is not None:
        out.right, out.right_hand = pull(a.right, b.right, part), slerp(a.right_hand, b.right_hand, part)
    return out


def _seen(targets: Targets, yaw: float) -> TrackedFrames:
    """One moment as the network takes it."""
    at = [targets.left or targets.eye, targets.right or targets.eye]
    turns = quaternion_matrices(np.array([targets.head, targets.left_hand, targets.right_hand])).astype(np.float32)
    tracked = [targets.left is not None, targets.right is not None]
    return TrackedFrames(
        np.array([targets.eye], np.float32),
        np.array([yaw], np.float32),
        turns[:1],
        np.array([at], np.float32),
        turns[None, 1:],
        np.array([tracked], np.float32),
    )


def _plain(guess: Guess, eye: Vec, yaw: float) -> _Said:
    points, ahead = guess.points[0].tolist(), guess.ahead[0].tolist()
    facing = yaw_quat(yaw)

    def world(v: list[float]) -> Vec:
        x, y, z = rotate(facing, (v[0], v[1], v[2]))
        return (eye[0] + x, y, eye[2] + z)

    def from_eye(v: list[float]) -> Vec:
        return rotate(facing, (v[0], v[1] - eye[1], v[2]))

    feet = [world(v) for v in points[3:]]
    later = [world(v) for v in ahead]
    stands = [1 / (1 + exp(-max(-30.0, min(30.0, c)))) for c in guess.contact[0].tolist()]
    return _Said(
        mul(facing, _rotation(guess.pelvis[0])),
        mul(facing, _rotation(guess.chest[0])),
        from_eye(points[0]),
        (from_eye(points[1]), from_eye(points[2])),
        (feet[0], feet[1], feet[2], feet[3]),
        (later[0], later[1], later[2], later[3]),
        (stands[0], stands[1]),
    )


def _rotation(axes: Array) -> Quat:
    """The rotation nearest to these x and z axes in the way of Gram and Schmidt, x first."""
    (ax, bx), (ay, by), (az, bz) = axes.tolist()
    n = max((ax * ax + ay * ay + az * az) ** 0.5, 1e-9)
    ax, ay, az = ax / n, ay / n, az / n
    s = ax * bx + ay * by + az * bz
    bx, by, bz = bx - s * ax, by - s * ay, bz - s * az
    n = (bx * bx + by * by + bz * bz) ** 0.5
    if n < 1e-6:
        bx, by, bz, n = 0.0, 0.0, 1.0, 1.0
    bx, by, bz = bx / n, by / n, bz / n
    return from_axes((ax, ay, az), (by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax), (bx, by, bz))
