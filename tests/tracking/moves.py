"""Made-up head and hands, and a tracker run over them with the promises every run has to keep."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Tracker
from glsplat.tracking.solve.body import HAND_FRAMES, HEAD_FRAME, Body
from glsplat.tracking.solve.limits import violation
from glsplat.tracking.solve.quat import Quat, mul, to_quat, yaw_quat

Vec = tuple[float, float, float]
DT = 1 / 72
DECLARED = {"teleport", "gap", "clock"}


def _xyzw(q: Quat) -> tuple[float, float, float, float]:
    return (q[1], q[2], q[3], q[0])


def head_turn(yaw: float = 0.0, pitch: float = 0.0, roll: float = 0.0) -> tuple[float, float, float, float]:
    """OpenXR head orientation for a body that faces +z at yaw 0; pitch down and roll about the nose are positive."""
    turn = mul(mul(yaw_quat(yaw), to_quat((pitch, 0.0, 0.0))), to_quat((0.0, 0.0, roll)))
    return _xyzw(mul(turn, HEAD_FRAME))


def hand_turn(side: str, vector: Vec = (0.0, 0.0, 0.0)) -> tuple[float, float, float, float]:
    """OpenXR wrist orientation of a wrist joint turned by this rotation vector from the T-pose."""
    return _xyzw(mul(to_quat(vector), HAND_FRAMES[side]))


@dataclass(frozen=True)
class Stage:
    """Where head and hands of a standing user are."""

    body: Body

    @property
    def eye(self) -> Vec:
        return (0.0, self.body.eye_height, 0.13)

    def hand(self, side: str, x: float = 0.25, y: float = 0.62, z: float = 0.15) -> Vec:
        """x outwards, y as a share of the eye height, z forwards."""
        return (x if side == "left" else -x, y * self.body.eye_height, z)

    def sample(
        self,
        t: float,
        head: Vec | None = None,
        turn: tuple[float, ...] | None = None,
        left: Vec | str | None = "rest",
        right: Vec | str | None = "rest",
        left_turn: tuple[float, ...] | None = None,
        right_turn: tuple[float, ...] | None = None,
        **more: Any,
    ) -> Sample:
        places = {"left": left, "right": right}
        turns = {"left": left_turn, "right": right_turn}
        poses: dict[str, Any] = {}
        for side, place in places.items():
            place = self.hand(side) if place == "rest" else place
            hang = (0.0, 0.0, -1.2 if side == "left" else 1.2)
            poses[side] = None if place is None else (*place, *(turns[side] or hand_turn(side, hang)))
        return Sample(t, (*(head or self.eye), *(turn or head_turn())), poses["left"], poses["right"], **more)


@dataclass(frozen=True, eq=False)
class Run:
    """What a tracker made of some samples."""

    tracker: Tracker
    rotations: NDArray[np.float64]
    trans: NDArray[np.float64]
    flags: list[tuple[str, ...]]
    reach: list[tuple[float | None, float | None]]
    times: NDArray[np.float64]
    joints: NDArray[np.float64]

    def rates(self) -> NDArray[np.float64]:
        """[T-1, 22] rad/s from sample to sample; 0 where a jump was declared."""
        frames = rotation_matrices(self.rotations[:, :22])
        trace = np.einsum("tjab,tjab->tj", frames[1:], frames[:-1])
        angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
        angle[angle < 1e-6] = 0  # what arccos cannot tell from none
        steps = np.diff(self.times)
        out = np.where(angle > 0, angle / np.maximum(steps, 1e-12)[:, None], 0.0)
        out[[bool(DECLARED & set(flags)) for flags in self.flags[1:]]] = 0
        return out


def run(skeleton: Skeleton, samples: Iterable[Sample], fastest: float = 60.0, **options: Any) -> Run:
    """Track the samples and check the promises: finite, inside the joint limits, no faster than the rate limit."""
    samples = list(samples)
    tracker = Tracker(skeleton, **options)
    rotations, trans, flags, reach, joints = [], [], [], [], []
    for sample in samples:
        pose = tracker.update(sample)
        rotations.append(pose.rotations)
        trans.append(pose.trans)
        flags.append(tracker.flags)
        reach.append(tracker.reach_error)
        joints.append(tracker.joints(pose))
    times = np.array([s.t for s in samples])
    result = Run(tracker, np.array(rotations), np.array(trans), flags, reach, times, np.array(joints))
    assert np.isfinite(result.rotations).all() and np.isfinite(result.trans).all()
    assert max(violation(r) for r in result.rotations) < 0.5
    if len(samples) > 1 and (np.diff(times) > 0).all():
        assert result.rates().max() < fastest
    return result


Track = Callable[..., Run]


def seconds(length: float, dt: float = DT) -> list[float]:
    return [i * dt for i in range(math.ceil(length / dt))]
