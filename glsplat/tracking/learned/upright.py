"""Where the pelvis of somebody upright is under this head: a third opinion, off in other ways than the other two."""

from __future__ import annotations

from math import asin

from glsplat.tracking.solve.body import HEAD, NECK, PELVIS, Body
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, length, rotate, scale, sub, unit, yaw_quat

__all__ = ["Upright"]

SHARE = 0.3  # of the pelvis that is this opinion's
LOW = (0.72, 0.85)  # of the eye height: lower, nobody is upright and it has no say, higher, it has all of SHARE
SINKS = (0.85, 0.5)  # of what a head is lower that the pelvis is, under eyes that look ahead, and down
AHEAD, DOWN = 0.3, 0.7  # radians that a head looks down by, likewise


class Upright:
    """The pelvis as far from the neck as at rest, and as far behind and below the head, less what knees bend."""

    def __init__(self, body: Body) -> None:
        joints = body.joints
        self.eye: Vec = body.eye
        self.neck: Vec = sub(joints[NECK], joints[HEAD])
        self.pelvis: Vec = sub(joints[PELVIS], joints[HEAD])
        self.torso: float = length(sub(joints[NECK], joints[PELVIS]))
        self.height: float = joints[HEAD][1] - body.ground
        self.low: tuple[float, float] = (LOW[0] * body.eye_height, LOW[1] * body.eye_height)

    def share(self, eye: Vec) -> float:
        """How much of the pelvis is this opinion's: 0 to SHARE."""
        low, high = self.low
        return SHARE * clamp((eye[1] - low) / (high - low), 0.0, 1.0)

    def place(self, eye: Vec, head: Quat, yaw: float) -> Vec:
        """The pelvis under a head, in a body that faces ``yaw``."""
        skull = sub(eye, rotate(head, self.eye))
        x, y, z = add(skull, rotate(yaw_quat(yaw), self.pelvis))
        looks_down = asin(clamp(-rotate(head, (0.0, 0.0, 1.0))[1], -1.0, 1.0))
        ahead, down = SINKS
        sinks = ahead + (down - ahead) * clamp((looks_down - AHEAD) / (DOWN - AHEAD), 0.0, 1.0)
        y += (1 - sinks) * max(self.height - skull[1], 0.0)
        neck = add(skull, rotate(head, self.neck))
        return add(neck, scale(unit(sub((x, y, z), neck), (0.0, -1.0, 0.0)), self.torso))
