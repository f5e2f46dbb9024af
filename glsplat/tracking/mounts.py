"""How a tracker sits on a body: the rigid offset from its pose to a joint's, learned while both are known.

A pose here is a place (metres) and a rotation in one space; a mount is the joint's pose in the tracker's frame, in the
same metres. Joints: pelvis for the waist, ankles for the feet, as in the rest frames of SMPL-X.
"""

from __future__ import annotations

from math import sqrt

from glsplat.tracking.sample import Transform
from glsplat.tracking.solve.body import ANKLES, EYES, PELVIS, Body
from glsplat.tracking.solve.quat import (
    IDENTITY,
    Quat,
    Vec,
    add,
    conj,
    inverse_mul,
    length,
    mul,
    normalized,
    rotate,
    scale,
    sub,
    yaw_quat,
)

__all__ = ["JOINTS", "MOST", "Mean", "Pose", "between", "mounted", "numbers", "standing", "within"]

Pose = tuple[Vec, Quat]

JOINTS = (PELVIS, *ANKLES)
"""Of the waist, the left and the right foot, in the order of ``TRACKERS``."""

MOST = (0.25, 0.2, 0.2)
"""Metres from a tracker to its joint at most: it is on the body of whoever wears it."""


def mounted(tracker: Pose, mount: Pose) -> Pose:
    """The joint's pose."""
    (at, turn), (offset, twist) = tracker, mount
    return add(at, rotate(turn, offset)), mul(turn, twist)


def between(tracker: Pose, joint: Pose) -> Pose:
    """The mount of a tracker whose joint is there."""
    return rotate(conj(tracker[1]), sub(joint[0], tracker[0])), inverse_mul(tracker[1], joint[1])


def within(mount: Pose, most: float) -> Pose:
    """The same, its place at most this far away."""
    far = length(mount[0])
    return mount if far <= most else (scale(mount[0], most / far), mount[1])


def standing(body: Body, eye: Vec, yaw: float) -> list[Pose]:
    """Pelvis and ankles of the zero pose on the ground, its eyes over those of somebody who faces ``yaw``."""
    turn = yaw_quat(yaw)
    a, b = (body.joints[joint] for joint in EYES)
    x, _, z = rotate(turn, (0.5 * (a[0] + b[0]), 0.0, 0.5 * (a[2] + b[2])))
    origin = (eye[0] - x, -body.ground, eye[2] - z)
    return [(add(origin, rotate(turn, body.joints[joint])), turn) for joint in JOINTS]


class Mean:
    """Of several mounts, each worth some time."""

    def __init__(self) -> None:
        self.worth = 0.0
        self._place: Vec = (0.0, 0.0, 0.0)
        self._turn: Quat = (0.0, 0.0, 0.0, 0.0)
        self._first: Quat | None = None

    def add(self, mount: Pose, worth: float) -> None:
        """One more."""
        place, turn = mount
        first = self._first = self._first or turn
        sign = worth if sum([a * b for a, b in zip(first, turn, strict=True)]) >= 0 else -worth
        w, x, y, z = self._turn
        self._turn = (w + sign * turn[0], x + sign * turn[1], y + sign * turn[2], z + sign * turn[3])
        self._place = add(self._place, scale(place, worth))
        self.worth += worth

    def pose(self) -> Pose:
        """The mean; the identity where there was none."""
        if self.worth <= 0:
            return (0.0, 0.0, 0.0), IDENTITY
        return scale(self._place, 1 / self.worth), normalized(self._turn)


def numbers(mount: Pose, metres: float) -> Transform:
    """x, y, z times ``metres``, then the quaternion x, y, z, w."""
    (x, y, z), (w, i, j, k) = mount
    n = 1 / sqrt(w * w + i * i + j * j + k * k)
    return (x * metres, y * metres, z * metres, i * n, j * n, k * n, w * n)
