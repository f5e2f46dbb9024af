"""The open body: a mesh of a person with ten shape parameters, on the 55 joints of SMPL-X (glsplat/data)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from glsplat.arrays import F64, frozen
from glsplat.extras.authoring.compute.threads import locked_cached_property
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

Indices = NDArray[np.intp]

BETAS = 10
"""Number of shape parameters."""


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """K points that move with the body: rest positions, blend shapes and skinning."""

    rest: F64  # [K, 3] metres, in the zero pose and shape
    shape: F64  # [K, 3, BETAS] metres per unit of shape
    joints: Indices  # [K, N]
    weights: F64  # [K, N] rows sum to one


@dataclass(frozen=True, eq=False)
class Body:
    """The mesh in the zero pose: y up, facing +z, +x the person's left, soles at y = -0.80 for the zero shape."""

    vertices: F64  # [V, 3] metres
    faces: NDArray[np.int32]  # [F, 3]
    uv: F64  # [F, 3, 2] texture coordinates of the corners, v up
    joints: F64  # [55, 3] metres
    shape: F64  # [V, 3, BETAS] metres per unit of shape (one standard deviation)
    shape_joints: F64  # [55, 3, BETAS]
    skin_joints: Indices  # [V, 4]
    skin_weights: F64  # [V, 4] rows sum to one

    def shaped(self, betas: F64) -> tuple[F64, F64]:
        """Return vertices [V, 3] and joints [55, 3] of a shape [BETAS] in the zero pose, metres."""
        return self.vertices + self.shape @ betas, self.joints + self.shape_joints @ betas

    def points(self, vertices: Indices, moved: F64 | None = None) -> Points:
        """Return the ``vertices`` [K] as points; ``moved`` [V, 3] metres is added to the mesh at rest."""
        rest = self.vertices[vertices] if moved is None else self.vertices[vertices] + moved[vertices]
        return Points(rest, self.shape[vertices], self.skin_joints[vertices], self.skin_weights[vertices])

    def points_of_joints(self, names: Sequence[str]) -> Points:
        """Return the named joints as points."""
        joints = np.array([JOINT_NAMES.index(name) for name in names], np.intp)
        return Points(self.joints[joints], self.shape_joints[joints], joints[:, None], np.ones((len(joints), 1)))

    @locked_cached_property
    def stature(self) -> tuple[float, F64]:
        """Height from sole to crown of the zero shape, metres, and its derivative by the shape [BETAS]."""
        top, sole = int(self.vertices[:, 1].argmax()), int(self.vertices[:, 1].argmin())
        return float(self.vertices[top, 1] - self.vertices[sole, 1]), self.shape[top, 1] - self.shape[sole, 1]

    @locked_cached_property
    def hip_height(self) -> tuple[float, F64]:
        """Height of the pelvis above the sole of the zero shape, metres, and its derivative by the shape [BETAS]."""
        sole = int(self.vertices[:, 1].argmin())
        return float(self.joints[0, 1] - self.vertices[sole, 1]), self.shape_joints[0, 1] - self.shape[sole, 1]

    @locked_cached_property
    def skin(self) -> NDArray[np.bool_]:
        """[V] the vertices of the largest connected surface, without eyes and the mouth's inside."""
        label = connected_components(self.neighbours)[1]
        return np.asarray(label == np.bincount(label).argmax())

    @locked_cached_property
    def neighbours(self) -> csr_matrix:
        """[V, V] adjacency matrix: 1 if an edge joins two vertices."""
        ends = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        ends = np.unique(np.sort(ends, axis=1), axis=0)
        both = np.concatenate([ends, ends[:, ::-1]])
        count = len(self.vertices)
        return coo_matrix((np.ones(len(both)), both.T), (count, count)).tocsr()

    @locked_cached_property
    def part(self) -> Indices:
        """[V] the joint with the largest weight."""
        return strongest_joint(self.skin_joints, self.skin_weights)


@lru_cache(maxsize=1)
def open_body() -> Body:
    """Return the embedded body (licence beside the file); it is read once, its arrays are read-only."""
    with resources.as_file(resources.files("glsplat.data") / "open_body.npz") as path, np.load(path) as data:
        weights = data["skin_weights"].astype(np.float64)
        assert len(data["joints"]) == len(JOINT_NAMES) == len(PARENTS)
        return Body(
            vertices=frozen(data["vertices"].astype(np.float64)),
            faces=frozen(data["faces"].astype(np.int32)),
            uv=frozen(data["uv"][data["faces_uv"].astype(np.int64)].astype(np.float64)),
            joints=frozen(data["joints"].astype(np.float64)),
            shape=frozen(data["shape"].astype(np.float64)),
            shape_joints=frozen(data["shape_joints"].astype(np.float64)),
            skin_joints=frozen(data["skin_indices"].astype(np.intp)),
            skin_weights=frozen(weights / weights.sum(axis=1, keepdims=True)),
        )
