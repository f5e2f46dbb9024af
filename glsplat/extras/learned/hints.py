"""The network's hints in the world: it runs at its own rate, its outputs are interpolated for each sample."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, exp, hypot

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.learned.network import (
    TICK_S,
    NetworkOutput,
    PoseNetwork,
    TrackedFrames,
    network_inputs,
    unit_of,
    updated_means,
)
from glsplat.rotations import quaternion_matrices
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import ANKLES, FEET, Body
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, length, pull, rotate, scale, sub
from glsplat.tracking.solve.solution import Targets

Array = NDArray[np.float32]

TORSO_SMOOTHING_S = (0.024, 0.024, 0.024)  # of successive low passes on torso and knees
JUMP_SMOOTHING_S = 0.04  # in which the difference between a tick and its prediction fades from the feet
MISS_SHARE = 0.3  # weight of the newest tick in the smoothed steps and errors of feet
CONFIDENCE_GAIN = 1.3  # of 1 - error / step of a foot
ROUNDING_S = 1e-6

_Pose = tuple[Quat, Quat, Vec, Vec, Vec, float, float]
"""Pelvis, chest, position of the pelvis, of both knees, stance of both feet; positions from the eyes."""


@dataclass(slots=True)
class FootHint:
    """One foot, in the world."""

    ball: Vec  # its goal
    speed: Vec  # m/s
    yaw: float  # radians
    pitch: float  # radians, the heel up
    stance: float  # 0 in the air .. 1 on the ground
    confidence: float  # 0 .. 1: how well the network has lately predicted this foot
    knee: Vec  # position of the knee


@dataclass(slots=True)
class Hint:
    """The body that the network estimates for this sample, in the world."""

    pelvis_at: Vec
    pelvis: Quat
    chest: Quat
    feet: tuple[FootHint, FootHint]


@dataclass(slots=True)
class _Tick:
    """A network's output as plain numbers, in the world, so that later turns of the head do not turn the body."""

    pelvis: Quat
    chest: Quat
    pelvis_at: Vec  # from the eyes
    knees: tuple[Vec, Vec]
    now: tuple[Vec, Vec, Vec, Vec]  # ankles, feet
    ahead: tuple[Vec, Vec, Vec, Vec]  # one tick later
    stance: tuple[float, float]


def _towards(a: _Pose, b: _Pose, k: float) -> _Pose:
    """Return ``a``, moved by the fraction k of the way to ``b``."""
    return (
        quat.nlerp(a[0], b[0], k),
        quat.nlerp(a[1], b[1], k),
        pull(a[2], b[2], k),
        pull(a[3], b[3], k),
        pull(a[4], b[4], k),
        a[5] + (b[5] - a[5]) * k,
        a[6] + (b[6] - a[6]) * k,
    )


class Hints:
    """Runs the network at RATE_HZ for samples of any rate.

    A tick uses targets interpolated between two samples. Between ticks feet move towards the positions that the network
    predicts for the next one.
    """

    def __init__(self, body: Body, network: PoseNetwork) -> None:
        self.network = network
        self.unit: float = unit_of(body.eye_height)
        # heading and slope of a foot at rest, from ankle to ball
        lines = [np.subtract(body.joints[FEET[i]], body.joints[ANKLES[i]]) for i in (0, 1)]
        self.rest: list[tuple[float, float]] = [(atan2(v[0], v[2]), atan2(-v[1], hypot(v[0], v[2]))) for v in lines]
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self.state: Array = self.network.start()
        self._last: tuple[Targets, float] | None = None  # newest sample and its heading
        self._frames: TrackedFrames | None = None  # of the last tick
        self._means: Array = np.zeros((1, 3, 2), np.float32)
        self._since_s = 0.0  # from the last tick to the newest sample
        self._newest: _Tick | None = None
        self._steps, self._misses = [0.0, 0.0], [0.0, 0.0]  # smoothed metres a tick: predicted, and their errors
        self._offsets: list[Vec] = [(0.0, 0.0, 0.0)] * 4  # from the newest tick to the shown feet, fading
        self._stages: list[_Pose] = []  # of the low passes

    def update(self, targets: Targets, dt: float) -> Hint:
        """Return the hint for these targets, ``dt`` seconds after the last ones."""
        seen = quat.swing_twist_y(targets.head)
        yaw = self._last[1] if seen is None and self._last else (seen or 0.0)
        if self._last is None:
            self._tick(targets, yaw)
        else:
            before, turned = self._last
            self._since_s += dt
            while self._since_s >= TICK_S - ROUNDING_S:
                self._since_s = max(self._since_s - TICK_S, 0.0)
                part = 1 - self._since_s / dt if dt > 0 else 1.0
                if part >= 1 - 1e-6:
                    self._tick(targets, yaw)
                else:
                    between = _between(before, targets, max(part, 0.0))
                    seen = quat.swing_twist_y(between.head)
                    self._tick(between, turned if seen is None else seen)
        self._last = (targets, yaw)
        return self._hint(targets, dt)

    def _tick(self, targets: Targets, yaw: float) -> None:
        now = _frames(targets, yaw)
        if self._frames is None:
            self._frames = now
            self._means = np.repeat(now.eye[:, None, [0, 2]], 3, 1)
        self._means = updated_means(self._means, now.eye)
        inputs = network_inputs(now, self._frames, self._means, self.unit)[0]
        numbers, self.state = self.network.step(inputs, self.state)
        self._frames = now
        old, new = self._newest, _tick(NetworkOutput.of(numbers[None], self.unit), targets.eye, yaw)
        self._newest = new
        if old is None:
            return
        self._offsets = [sub(add(a, o), n) for a, o, n in zip(old.ahead, self._offsets, new.now, strict=True)]
        # far from its training the network predicts feet badly
        for side in (0, 1):
            was, predicted, ball = old.now[side + 2], old.ahead[side + 2], new.now[side + 2]
            step, miss = self._steps[side], self._misses[side]
            self._steps[side] = step + MISS_SHARE * (length(sub(predicted, was)) - step)
            self._misses[side] = miss + MISS_SHARE * (length(sub(ball, predicted)) - miss)

    def _hint(self, targets: Targets, dt: float) -> Hint:
        """Return the newest tick's body, interpolated towards the next tick."""
        tick = self._newest
        assert tick is not None
        part = min(self._since_s / TICK_S, 1.0)
        fade = exp(-dt / JUMP_SMOOTHING_S)
        self._offsets = [scale(offset, fade) for offset in self._offsets]
        ankles_feet = [add(pull(a, b, part), o) for a, b, o in zip(tick.now, tick.ahead, self._offsets, strict=True)]
        pose: _Pose = (tick.pelvis, tick.chest, tick.pelvis_at, *tick.knees, *tick.stance)
        self._stages = self._stages or [pose] * len(TORSO_SMOOTHING_S)
        for i, tau in enumerate(TORSO_SMOOTHING_S):
            self._stages[i] = pose = _towards(self._stages[i], pose, 1 - exp(-dt / tau))
        pelvis, chest, at, *knees = pose[:5]
        stance = self._stages[1][5:]  # one low pass less, or feet would be late
        eye = targets.eye
        feet = []
        for side in (0, 1):
            ankle, ball = ankles_feet[side], ankles_feet[side + 2]
            x, y, z = sub(ball, ankle)
            rest_yaw, rest_slope = self.rest[side]
            confidence = CONFIDENCE_GAIN * (1 - self._misses[side] / max(self._steps[side], 1e-3))
            step = sub(tick.ahead[side + 2], tick.now[side + 2])
            feet.append(
                FootHint(
                    ball,
                    (step[0] / TICK_S, step[1] / TICK_S, step[2] / TICK_S),
                    atan2(x, z) - rest_yaw,
                    atan2(-y, max(hypot(x, z), 1e-6)) - rest_slope,
                    stance[side],
                    clamp(confidence, 0.0, 1.0),
                    add(eye, knees[side]),
                )
            )
        return Hint(add(eye, at), pelvis, chest, (feet[0], feet[1]))


def _between(a: Targets, b: Targets, part: float) -> Targets:
    """Interpolate two samples; a hand is tracked if both have it."""
    out = Targets(pull(a.eye, b.eye, part), quat.slerp(a.head, b.head, part))
    if a.left is not None and b.left is not None:
        out.left, out.left_hand = pull(a.left, b.left, part), quat.slerp(a.left_hand, b.left_hand, part)
    if a.right is not None and b.right is not None:
        out.right, out.right_hand = pull(a.right, b.right, part), quat.slerp(a.right_hand, b.right_hand, part)
    return out


def _frames(targets: Targets, yaw: float) -> TrackedFrames:
    """Return the arrays of one sample."""
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


def _tick(output: NetworkOutput, eye: Vec, yaw: float) -> _Tick:
    """Return the first frame of an output in the world."""
    points, ahead = output.points[0].tolist(), output.ahead[0].tolist()
    facing = quat.yaw_quat(yaw)

    def world(v: list[float]) -> Vec:
        x, y, z = rotate(facing, (v[0], v[1], v[2]))
        return (eye[0] + x, y, eye[2] + z)

    def from_eye(v: list[float]) -> Vec:
        return rotate(facing, (v[0], v[1] - eye[1], v[2]))

    feet = [world(v) for v in points[3:]]
    later = [world(v) for v in ahead]
    stance = [1 / (1 + exp(-max(-30.0, min(30.0, c)))) for c in output.contact[0].tolist()]
    return _Tick(
        quat.mul(facing, _rotation(output.pelvis[0])),
        quat.mul(facing, _rotation(output.chest[0])),
        from_eye(points[0]),
        (from_eye(points[1]), from_eye(points[2])),
        (feet[0], feet[1], feet[2], feet[3]),
        (later[0], later[1], later[2], later[3]),
        (stance[0], stance[1]),
    )


def _rotation(axes: Array) -> Quat:
    """Return the rotation of these x and z axes, made orthonormal (Gram-Schmidt, x first)."""
    (ax, bx), (ay, by), (az, bz) = axes.tolist()
    n = max((ax * ax + ay * ay + az * az) ** 0.5, 1e-9)
    ax, ay, az = ax / n, ay / n, az / n
    s = ax * bx + ay * by + az * bz
    bx, by, bz = bx - s * ax, by - s * ay, bz - s * az
    n = (bx * bx + by * by + bz * bz) ** 0.5
    if n < 1e-6:
        bx, by, bz, n = 0.0, 0.0, 1.0, 1.0
    bx, by, bz = bx / n, by / n, bz / n
    return quat.from_axes((ax, ay, az), (by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax), (bx, by, bz))
