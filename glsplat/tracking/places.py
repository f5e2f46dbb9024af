"""A body that a device tracks itself, joint by joint: pelvis, feet and knees of its places alone.

Only places, because what the axes of a joint are differs between runtimes, and these say it all: the pelvis turns with
the line between the hips, a foot with the plane of shin and foot.
"""

from __future__ import annotations

from collections.abc import Callable

from glsplat.tracking.mounts import Pose
from glsplat.tracking.solve.body import ANKLES, FEET, HIPS, PELVIS, SPINE1, Body
from glsplat.tracking.solve.quat import Quat, Vec, conj, cross, dot, from_axes, length, mul, pull, rotate, sub, unit

__all__ = ["Places"]

FLAT = 0.17  # sine of the least angle between two directions that make a plane
NEAREST = 0.01  # metres; joints nearer than this have no direction

Place = Callable[[str], Vec | None]


class Places:
    """The rest measures that this takes."""

    def __init__(self, body: Body) -> None:
        joints = body.joints
        self._hips = pull(sub(joints[HIPS[0]], joints[PELVIS]), sub(joints[HIPS[1]], joints[PELVIS]), 0.5)
        across = sub(joints[HIPS[0]], joints[HIPS[1]])
        self._pelvis = _frame(across, sub(joints[SPINE1], joints[PELVIS]))
        shins = [(0.0, 1.0, 0.0)] * 2  # up: a rest pose's knees are behind or before the ankles as its maker liked
        soles = [sub(joints[foot], joints[ankle]) for foot, ankle in zip(FEET, ANKLES, strict=True)]
        self._feet = [_frame(cross(shin, sole), sole) for shin, sole in zip(shins, soles, strict=True)]

    def pelvis(self, at: Place) -> Pose | None:
        """From both hips and the way up the spine; None where one is missing or they are in one place."""
        left, right, low, up = at("left-upper-leg"), at("right-upper-leg"), at("hips"), at("spine-lower")
        if left is None or right is None or low is None or up is None:
            return None
        now = _frame(sub(left, right), sub(up, low))
        if now is None or self._pelvis is None:
            return None
        turn = mul(now, conj(self._pelvis))
        return sub(pull(left, right, 0.5), rotate(turn, self._hips)), turn

    def foot(self, index: int, at: Place) -> Pose | None:
        """The ankle, and the rotation of the foot: left 0, right 1."""
        side = ("left", "right")[index]
        knee, ankle, ball = at(f"{side}-lower-leg"), at(f"{side}-foot-ankle"), at(f"{side}-foot-ball")
        rest = self._feet[index]
        if knee is None or ankle is None or ball is None or rest is None:
            return None
        shin, sole = sub(knee, ankle), sub(ball, ankle)
        across = cross(shin, sole)
        if length(across) < FLAT * length(shin) * length(sole):
            return None
        now = _frame(across, sole)
        return None if now is None else (ankle, mul(now, conj(rest)))

    @staticmethod
    def knee(index: int, at: Place) -> Vec | None:
        """Its place."""
        return at(("left-lower-leg", "right-lower-leg")[index])


def _frame(across: Vec, along: Vec) -> Quat | None:
    """Axes x ``across`` and as near to ``along`` as a right angle allows; None where they are one direction."""
    if length(across) < NEAREST**2 or length(along) < NEAREST:
        return None
    x, y = unit(across), unit(along)
    z = cross(x, y)
    if length(z) < FLAT:
        return None
    z = unit(z)
    assert abs(dot(z, x)) < 1e-6
    return from_axes(x, cross(z, x), z)
