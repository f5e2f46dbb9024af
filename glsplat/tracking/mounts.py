"""Mounts: the rigid offset from a body tracker's pose to its joint's, learned while both are known.

A mount is the joint's pose in the tracker's frame, in metres of the avatar. Joints: pelvis for the waist, ankles for
the feet, as in the rest frames of SMPL-X.
"""

from __future__ import annotations

from math import sqrt

from glsplat.tracking.sample import Transform
from glsplat.tracking.solve.body import ANKLES, EYES, PELVIS, Body
from glsplat.tracking.solve.quat import IDENTITY, JointPose, Quat, Vec, add, length, normalized, rotate, scale, yaw_quat

JOINTS = (PELVIS, *ANKLES)
"""Joints of the waist, the left and the right foot, in the order of ``TRACKERS``."""

MAX_MOUNT_M = (0.25, 0.2, 0.2)
"""Limit of the distance from each tracker to its joint: a tracker is on its user's body."""


def bounded(mount: JointPose, most: float) -> JointPose:
    """Return the mount with its offset shortened to ``most`` metres."""
    far = length(mount[0])
    return mount if far <= most else (scale(mount[0], most / far), mount[1])


def standing_joints(body: Body, eye: Vec, yaw: float) -> list[JointPose]:
    """Return pelvis and ankles of the zero pose on the ground, its eyes over ``eye``, its heading ``yaw``."""
    turn = yaw_quat(yaw)
    a, b = (body.joints[joint] for joint in EYES)
    x, _, z = rotate(turn, (0.5 * (a[0] + b[0]), 0.0, 0.5 * (a[2] + b[2])))
    origin = (eye[0] - x, -body.ground, eye[2] - z)
    return [(add(origin, rotate(turn, body.joints[joint])), turn) for joint in JOINTS]


class MeanMount:
    """The weighted mean of several mounts."""

    def __init__(self) -> None:
        self.weight = 0.0
        self._offset: Vec = (0.0, 0.0, 0.0)
        self._turn: Quat = (0.0, 0.0, 0.0, 0.0)
        self._first: Quat | None = None

    def add(self, mount: JointPose, weight: float) -> None:
        """Add a mount."""
        offset, turn = mount
        first = self._first = self._first or turn
        sign = weight if sum([a * b for a, b in zip(first, turn, strict=True)]) >= 0 else -weight
        w, x, y, z = self._turn
        self._turn = (w + sign * turn[0], x + sign * turn[1], y + sign * turn[2], z + sign * turn[3])
        self._offset = add(self._offset, scale(offset, weight))
        self.weight += weight

    def mount(self) -> JointPose:
        """Return the mean; the identity where nothing was added."""
        if self.weight <= 0:
            return (0.0, 0.0, 0.0), IDENTITY
        return scale(self._offset, 1 / self.weight), normalized(self._turn)


def transform_of(mount: JointPose, metres: float) -> Transform:
    """Return x, y, z times ``metres``, then the quaternion x, y, z, w."""
    (x, y, z), (w, i, j, k) = mount
    n = 1 / sqrt(w * w + i * i + j * j + k * k)
    return (x * metres, y * metres, z * metres, i * n, j * n, k * n, w * n)
