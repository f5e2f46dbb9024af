"""Bounding boxes of skinned things and of avatars in a pose, without posing their splats."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import Avatar
from glsplat.rotations import quaternion_matrices
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

_DIRECTIONS = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))  # [27, 3]; the middle one is no direction
_STEPS = np.array([9, 3, 1])  # of a direction's index in that list, by the sign of x, y, z
_AXES = np.concatenate([np.eye(3), -np.eye(3)])


@dataclass(frozen=True, eq=False, repr=False)
class Extent:
    """Bounds of the splats or vertices of each joint, in 26 directions of the zero pose.

    A splat or vertex belongs to the joint in its first slot (an avatar's anchor); the boxes of its other joints nearly
    always cover it, too.
    """

    joints: NDArray[np.intp]  # [B] joints with splats
    reach: NDArray[np.float64]  # [B, 27] metres: largest x . d, of splats over two standard deviations

    @classmethod
    def of(cls, splats: Splats, skin: Skin, sigmas: float = 2.0) -> Extent:
        """Measure the drawable ``splats`` (finite, not fully transparent) to ``sigmas`` standard deviations."""
        rows = np.flatnonzero(splats.finite() & (splats.opacities > 0))
        shapes = quaternion_matrices(splats.quats[rows]) * splats.scales[rows, None, :]
        return cls._of(splats.means[rows].astype(np.float64), skin.take(rows), sigmas * shapes)

    @classmethod
    def of_points(cls, points: NDArray[np.float64], skin: Skin) -> Extent:
        """Measure points [N, 3] without a size."""
        return cls._of(points, skin, np.zeros((len(points), 3, 1)))

    @classmethod
    def _of(cls, points: NDArray[np.float64], skin: Skin, shapes: NDArray[np.float64]) -> Extent:
        """Measure ellipsoids x + M u, |u| <= 1: ``points`` x [N, 3], ``shapes`` M [N, 3, K]."""
        squares = np.einsum("nik,njk->nij", shapes, shapes).reshape(-1, 9)
        pairs = np.einsum("di,dj->dij", _DIRECTIONS, _DIRECTIONS).reshape(-1, 9)
        reaches = points @ _DIRECTIONS.T + np.sqrt(np.maximum(squares @ pairs.T, 0.0))
        owners = skin.joints[:, 0]
        order = np.argsort(owners, kind="stable")
        joints, starts = np.unique(owners[order], return_index=True)
        reach = np.maximum.reduceat(reaches[order], starts, axis=0) if len(joints) else np.empty((0, 27))
        return cls(joints.astype(np.intp), frozen(reach))

    def box(self, bones: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the lowest and highest corner [2, 3] in metres under skinning matrices [J, 3, 4]; None: no splats.

        A few per cent larger than the tight box; never smaller where no splat is blended.
        """
        if not len(self.joints):
            return None
        carried = bones[self.joints]
        across = np.einsum("ai,bij->baj", _AXES, carried[:, :, :3])  # [B, 6, 3] the box's axes as each joint sees them
        reaches = self._reach(across) + np.einsum("ai,bi->ba", _AXES, carried[:, :, 3])
        most = reaches.max(axis=0)
        return np.stack([-most[3:], most[:3]])

    def _reach(self, across: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return upper bounds [B, A] of the largest x . d for directions d [B, A, 3].

        A support function is sublinear: d is a sum of an axis, a diagonal of a face and one of the cube, with weights
        that are not negative, and the support along d is at most the same sum of the supports along those.
        """
        size = np.abs(across)
        order = np.argsort(-size, axis=2)
        size = np.take_along_axis(size, order, axis=2)
        weights = size - np.concatenate([size[:, :, 1:], np.zeros_like(size[:, :, :1])], axis=2)
        signs = np.take_along_axis(np.where(across < 0, -1, 1), order, axis=2)
        indices = 13 + np.cumsum(signs * _STEPS[order], axis=2)  # one, two, then three axes together
        rows = np.arange(len(across))[:, None, None]
        return (weights * self.reach[rows, indices]).sum(axis=2)


class FigureBounds:
    """The boxes of one figure, measured on first use. Splats count with ``sigmas`` standard deviations.

    A box holds nearly all of the figure.
    """

    def __init__(self, figure: Rigged, sigmas: float) -> None:
        self.figure: Rigged = figure
        self._sigmas = sigmas
        self._state: tuple[object, ...] = ()
        self._box: NDArray[np.float64] | None = None

    def box(self, pose: Pose | None, transform: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the lowest and highest corner [2, 3] in the scene; None where nothing of it is drawn.

        ``pose`` None is the zero pose; ``transform`` [4, 4] takes the figure's space to the scene's.
        """
        posed = Pose.zero(len(self.figure.skeleton)) if pose is None else pose
        moved = b"" if posed.translations is None else posed.translations.tobytes()
        shape = tuple(posed.expression.items())
        state = posed.rotations.tobytes(), posed.trans.tobytes(), moved, shape, transform.tobytes()
        if state != self._state:  # viewers of the same pose share a box
            self._state, self._box = state, self._measured(posed, transform)
        return self._box

    def _measured(self, pose: Pose, transform: NDArray[np.float64]) -> NDArray[np.float64] | None:
        figure = self.figure
        bones = transform[:3, :3] @ pose.bones(figure.skeleton)
        bones[:, :, 3] += transform[:3, 3]
        box, grown = self._extent.box(bones), self._grown(pose)
        if box is None or not grown:
            return box
        size = float(np.cbrt(np.linalg.det(transform[:3, :3])))
        return np.asarray(box + size * grown * np.array([[-1.0], [1.0]]))

    def _grown(self, pose: Pose) -> float:
        """Return an upper bound in metres of the movements by the pose's expression."""
        figure = self.figure
        if not isinstance(figure, Avatar):
            return 0.0 if figure.morphs is None else figure.morphs.farthest(pose)
        weights = figure.weights(pose)
        return 0.0 if weights is None or figure.shapes is None else figure.shapes.farthest(weights)

    @cached_property
    def _extent(self) -> Extent:
        figure = self.figure
        if isinstance(figure, Avatar):
            return Extent.of(figure.splats, figure.skin, self._sigmas)
        used = np.unique(figure.faces)
        skin = Skin.create(figure.joints[used], figure.weights[used], len(figure.skeleton), influences=8)
        return Extent.of_points(figure.vertices[used], skin)
