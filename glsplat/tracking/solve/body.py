"""Body: the measures of a skeleton that tracking needs (eyes, soles, limb lengths, hand frames), taken once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.skinning.driven import why_not_tracked
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking.solve.quat import Quat, Vec, from_axes, rotate, unit

HEAD_FRAME: Quat = (0.0, 0.0, 1.0, 0.0)
"""OpenXR head axes (-z forward) in the head joint's rest frame (+z forward): half a turn about y."""

HAND_FRAMES: dict[str, Quat] = {
    "left": from_axes((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    "right": from_axes((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
}
"""OpenXR wrist axes (-z along the fingers, y out of the back of the hand) in the wrist joint's rest frame."""

TURNS_AT: Vec = (0.0, -0.09, -0.09)
"""From between the eyes to where a head that nods turns, metres."""

PELVIS, SPINE1, SPINE2, SPINE3, NECK, HEAD = 0, 3, 6, 9, 12, 15
HIPS, KNEES, ANKLES, FEET = (1, 2), (4, 5), (7, 8), (10, 11)
COLLARS, SHOULDERS, ELBOWS, WRISTS = (13, 14), (16, 17), (18, 19), (20, 21)
EYES = (23, 24)
FINGERS = (slice(25, 40), slice(40, 55))


def levelled(eye: Vec, head: Quat) -> Vec:
    """Return ``eye`` at its height if the head, rotated by ``head``, looked straight ahead."""
    return (eye[0], eye[1] + rotate(head, TURNS_AT)[1] - TURNS_AT[1], eye[2])


@dataclass(frozen=True)
class Body:
    """Rest measures of an SMPL-X-named skeleton, in its own metres."""

    rest: NDArray[np.float64]  # [55, 3] joints in the zero pose
    joints: tuple[Vec, ...]  # the same, as floats
    offsets: tuple[Vec, ...]  # each joint from its parent
    sole: float  # metres from the foot joint (the ball) down to the ground
    eye: Vec  # between the eyes, from the head joint
    eye_height: float  # of the zero pose above the ground

    @classmethod
    def of(cls, skeleton: Skeleton, sole: float | None = None) -> Body:
        """Measure a skeleton. Raises PoseError for a rig that is not the 55 joints of SMPL-X with parallel rest frames.

        ``sole``: height of the foot joint above the ground. Without it: its height above y = 0 if the rig stands there,
        else 1.65 % of the stature, as on the embedded body.
        """
        if why := why_not_tracked(skeleton):
            raise PoseError(f"tracking cannot drive this skeleton: {why}")
        rest = skeleton.joints
        foot = float(rest[list(FEET), 1].mean())
        eye = rest[list(EYES)].mean(0) - rest[HEAD]
        span = float(rest[HEAD, 1] + eye[1] - foot)
        if sole is None:
            sole = foot if 0.001 * span < foot < 0.05 * span else 0.0175 * span
        joints = tuple([(float(x), float(y), float(z)) for x, y, z in rest])
        parents = skeleton.parents
        offsets = tuple(
            [
                joints[j] if p < 0 else (float(v[0]), float(v[1]), float(v[2]))
                for j, p in enumerate(parents.tolist())
                for v in [rest[j] - rest[max(p, 0)]]
            ]
        )
        return cls(rest, joints, offsets, sole, (float(eye[0]), float(eye[1]), float(eye[2])), span + sole)

    @property
    def ground(self) -> float:
        """The y of the ground in the zero pose."""
        return self.joints[HEAD][1] + self.eye[1] - self.eye_height

    def distance(self, a: int, b: int) -> float:
        """Return the metres between two joints at rest."""
        return float(np.linalg.norm(self.rest[a] - self.rest[b]))

    def direction(self, a: int, b: int) -> Vec:
        """Return the unit vector from joint a to joint b at rest."""
        ax, bx = self.joints[a], self.joints[b]
        return unit((bx[0] - ax[0], bx[1] - ax[1], bx[2] - ax[2]))

    def arm_span(self) -> float:
        """Return the metres from wrist to wrist in the zero pose."""
        return self.distance(*WRISTS)
