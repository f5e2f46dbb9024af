"""Pose the body in a camera's axes, with exact derivatives of its points by shape and pose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import BETAS, Body, Points
from glsplat.rotations import rotation_matrices
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

Indices = NDArray[np.intp]

PLACE = 6
"""Size of a view's placement: the pelvis in camera axes [3] metres, then the root's turn [3] radians."""

_BELOW = np.zeros((len(PARENTS), len(PARENTS)), bool)  # [a, b]: b is a or a descendant of a
for _joint, _parent in enumerate(PARENTS):
    _BELOW[_joint, _joint] = True
    if _parent >= 0:
        _BELOW[:, _joint] |= _BELOW[:, _parent]


@dataclass(frozen=True, eq=False)
class Hinges:
    """The D fitted angles: components of joints' axis-angles, in their rest frames."""

    names: tuple[tuple[str, int], ...]  # joint name, axis 0..2

    @cached_property
    def joints(self) -> Indices:
        """[D] index of the joint."""
        return np.array([JOINT_NAMES.index(name) for name, _ in self.names], np.intp)

    @cached_property
    def axes(self) -> Indices:
        """[D] 0, 1 or 2."""
        return np.array([axis for _, axis in self.names], np.intp)

    def rotations(self, angles: F64) -> F64:
        """Return axis-angles [55, 3] of all joints from the fitted angles [D], radians; the root's row is zero."""
        full = np.zeros((len(JOINT_NAMES), 3))
        full[self.joints, self.axes] = angles
        return full


class PosedBody:
    """The body in one shape and pose, in one camera's axes (OpenCV: x right, y down, z forward; metres).

    ``place`` [6] is the pelvis's position and an axis-angle in camera axes that turns ``facing`` [3, 3], the body's
    axes in the camera's; ``angles`` [D] are those of ``hinges``, radians.
    """

    def __init__(self, body: Body, hinges: Hinges, facing: F64, betas: F64, place: F64, angles: F64) -> None:
        self.betas, self.place, self.hinges = betas, place, hinges
        self._rest = body.joints + body.shape_joints @ betas
        self._rest_shape = body.shape_joints
        turns = hinges.rotations(angles)
        local = rotation_matrices(turns)
        count = len(PARENTS)
        self.frames = np.empty((count, 3, 3))
        """[55, 3, 3] the joints' axes in the camera's."""
        self.joints = np.empty((count, 3))
        """[55, 3] metres."""
        self.joints_by_shape = np.zeros((count, 3, BETAS))
        """[55, 3, BETAS] metres per unit of shape, with the pelvis fixed."""
        self.frames[0] = rotation_matrices(place[3:]) @ facing
        self.joints[0] = place[:3]
        for joint in range(1, count):
            parent = PARENTS[joint]
            frame = self.frames[parent]
            self.frames[joint] = frame @ local[joint]
            self.joints[joint] = self.joints[parent] + frame @ (self._rest[joint] - self._rest[parent])
            bone = self._rest_shape[joint] - self._rest_shape[parent]
            self.joints_by_shape[joint] = self.joints_by_shape[parent] + frame @ bone
        # axes of rotation in the camera, for the derivatives: the root's three, then the hinges'
        parents = self.frames[PARENTS[hinges.joints]]
        columns = _left_jacobians(turns[hinges.joints])[np.arange(len(hinges.joints)), :, hinges.axes]
        self._axes = np.concatenate([_left_jacobians(place[None, 3:])[0].T, np.einsum("dij,dj->di", parents, columns)])
        self._at = np.concatenate([np.zeros(3, np.intp), hinges.joints])

    def axis_derivatives(self, axis: F64) -> F64:
        """Return the derivatives [3, 3] of an ``axis`` [3] fixed to the root, a row for each component of its turn."""
        return np.cross(self._axes[:3], axis)

    def points(self, points: Points) -> F64:
        """Return the positions [K, 3] of points, metres."""
        return np.einsum("kn,knc->kc", points.weights, self._carried(points))

    def derivatives(self, points: Points) -> tuple[F64, F64]:
        """Return positions [K, 3] and their derivatives [K, 3, BETAS + 6 + D] by shape, place and angles."""
        carried = self._carried(points)
        where = np.einsum("kn,knc->kc", points.weights, carried)
        # derivative for one joint: frame @ (point's derivative - joint's) + the joint's derivative in the camera
        frames = np.einsum("kn,knij->kij", points.weights, self.frames[points.joints])
        own = self.joints_by_shape - self.frames @ self._rest_shape  # [55, 3, BETAS]
        by_shape = frames @ points.shape + np.einsum("kn,knib->kib", points.weights, own[points.joints])
        part = _BELOW[self._at].T[points.joints].transpose(0, 2, 1) * points.weights[:, None]  # [K, 3 + D, N]
        lever = part @ carried - part.sum(-1)[..., None] * self.joints[self._at]
        (ax, ay, az), (x, y, z) = self._axes.T, np.moveaxis(lever, -1, 0)
        by_turn = np.stack([ay * z - az * y, az * x - ax * z, ax * y - ay * x], axis=1)  # axis x lever
        by_place = np.broadcast_to(np.eye(3), (len(where), 3, 3))
        return where, np.concatenate([by_shape, by_place, by_turn], axis=2)

    def _carried(self, points: Points) -> F64:
        """Return the positions [K, N, 3] of points, moved by each of their joints alone."""
        rest = points.rest + points.shape @ self.betas
        arm = rest[:, None] - self._rest[points.joints]
        return np.einsum("knij,knj->kni", self.frames[points.joints], arm) + self.joints[points.joints]


_ALL_HINGES = Hinges(tuple((name, axis) for name in JOINT_NAMES[1:] for axis in range(3)))


def fully_posed(body: Body, betas: F64, root: F64, pelvis: F64, rotations: F64) -> PosedBody:
    """Return the body with ``root`` [3, 3] and ``pelvis`` [3] in camera axes and axis-angles ``rotations`` [55, 3]."""
    return PosedBody(body, _ALL_HINGES, root, betas, np.concatenate([pelvis, np.zeros(3)]), rotations[1:].ravel())


def derivative_column(joint: str, axis: int) -> int:
    """Return the column of a ``fully_posed`` body's derivatives by component ``axis`` of a joint's axis-angle."""
    return BETAS + PLACE + 3 * (JOINT_NAMES.index(joint) - 1) + axis


def projected(where: F64, focal: float, centre: F64, moves: F64 | None = None) -> tuple[F64, F64]:
    """Return pixels [K, 2] of points [K, 3] in camera axes, and derivatives [K, 2, P] from ``moves`` [K, 3, P]."""
    depth = where[:, 2:]
    ratio = where[:, :2] / depth
    pixels = ratio * focal + centre
    if moves is None:
        return pixels, np.zeros((len(where), 2, 0))
    return pixels, (moves[:, :2] - ratio[..., None] * moves[:, 2:]) * (focal / depth)[..., None]


def _left_jacobians(turns: F64) -> F64:
    """Return J [N, 3, 3] with exp(turn + e) = exp(J e) exp(turn) to first order, for axis-angles [N, 3]."""
    square = (turns * turns).sum(-1)
    angle = np.sqrt(square)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - square / 24, (1 - np.cos(safe)) / safe**2)
    second = np.where(small, 1 / 6 - square / 120, (safe - np.sin(safe)) / safe**3)
    zero = np.zeros(len(turns))
    x, y, z = turns.T
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(-1, 3, 3)
    return np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)
