"""Points on the triangles of a mesh, and vertex values interpolated there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.arrays import F64
from glsplat.rotations import unit_vectors


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """M points on the triangles of a mesh of V vertices."""

    corners: NDArray[np.intp]  # [M, 3] vertices
    weights: F64  # [M, 3] barycentric

    def take(self, some: NDArray[np.intp] | NDArray[np.bool_] | slice) -> SurfacePoints:
        """Return a subset of the points."""
        return SurfacePoints(self.corners[some], self.weights[some])

    def at(self, values: F64) -> F64:
        """Return vertex values [V, C] interpolated at the points, [M, C]."""
        return self.matrix(len(values)) @ values

    def matrix(self, count: int) -> csr_array:
        """Return the weights as a sparse matrix [M, count]."""
        return barycentric_matrix(self.corners, self.weights, count)

    def directions(self, values: F64) -> F64:
        """Return vertex directions [V, 3] interpolated at the points, as unit vectors [M, 3]."""
        return unit_vectors(self.at(values))


def barycentric_matrix(corners: NDArray[Any], share: F64, count: int) -> csr_array:
    """Return the sparse matrix [M, count] of barycentric weights ``share`` [M, 3] on vertices ``corners`` [M, 3]."""
    return csr_array((share.ravel(), corners.ravel(), np.arange(len(corners) + 1) * 3), (len(corners), count))


def triangle_areas(vertices: F64, faces: NDArray[np.integer]) -> F64:
    """Return the areas [F] of triangles ``faces`` [F, 3] of ``vertices`` [V, 3], square metres."""
    corner = vertices[faces]
    return np.asarray(np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2)
