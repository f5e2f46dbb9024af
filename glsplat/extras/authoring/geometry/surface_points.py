"""Points on the triangles of a mesh, and what values of its vertices are there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.rotations import unit_vectors

__all__ = ["SurfacePoints", "between", "triangle_areas"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """M points on the triangles of a mesh of V vertices."""

    corners: NDArray[np.intp]  # [M, 3] vertices
    weights: F64  # [M, 3] barycentric

    def take(self, some: NDArray[np.intp] | NDArray[np.bool_] | slice) -> SurfacePoints:
        """N of the points."""
        return SurfacePoints(self.corners[some], self.weights[some])

    def at(self, values: F64) -> F64:
        """[M, C] what a value [V, C] of the vertices is there."""
        return self.matrix(len(values)) @ values

    def matrix(self, count: int) -> csr_array:
        """[M, V] the weights, of ``count`` vertices."""
        return between(self.corners, self.weights, count)

    def directions(self, values: F64) -> F64:
        """[M, 3] unit vectors between the vertices' [V, 3]."""
        return unit_vectors(self.at(values))


def between(corners: NDArray[Any], share: F64, count: int) -> csr_array:
    """[M, V] of points between vertices ``corners`` [M, 3], how much of each of ``count`` vertices they are."""
    return csr_array((share.ravel(), corners.ravel(), np.arange(len(corners) + 1) * 3), (len(corners), count))


def triangle_areas(vertices: F64, faces: NDArray[np.integer]) -> F64:
    """Return the areas [F] of triangles ``faces`` [F, 3] of ``vertices`` [V, 3], square metres."""
    corner = vertices[faces]
    return np.asarray(np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2)
