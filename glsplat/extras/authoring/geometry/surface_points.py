"""Points on the triangles of a mesh: vertex values interpolated there, and those nearest to other points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from glsplat.arrays import F64
from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths, unit_vectors

_CANDIDATES = 8  # triangles tested for each point
_SAMPLES_PER_TRIANGLE = 16  # on average, on small meshes


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """M points on the triangles of a mesh of V vertices."""

    corners: NDArray[np.intp]  # [M, 3] vertices
    weights: F64  # [M, 3] barycentric

    def take(self, some: NDArray[np.intp] | NDArray[np.bool_] | slice) -> SurfacePoints:
        """Return a subset of the points."""
        return SurfacePoints(self.corners[some], self.weights[some])

    def at(self, values: F64) -> F64:
        """Return vertex values [V] or [V, C] interpolated at the points, [M] or [M, C]."""
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


class NearestPoints(NamedTuple):
    """The places on a mesh's triangles that are nearest to N points."""

    points: F64  # [N, 3]
    distance: F64  # [N]
    faces: NDArray[np.intp]  # [N] their triangles
    weights: F64  # [N, 3] barycentric


class NearestWeights(NamedTuple):
    """The skinning of a mesh at the places nearest to N points."""

    joints: NDArray[np.int64]  # [N, J]
    weights: F64  # [N, J]
    distance: F64  # [N] of the points from the surface, metres


def nearest_weights(mesh: RiggedMesh, points: F64) -> NearestWeights:
    """Return the skinning of the surface points nearest to ``points`` [N, 3]."""
    near = nearest_on(mesh.vertices, mesh.faces, points)
    corners = mesh.faces[near.faces]
    count = len(mesh.skeleton)
    dense = np.zeros((len(points), count))  # the three corners may share joints
    values = (near.weights[:, :, None] * mesh.weights[corners]).reshape(len(points), -1)
    np.add.at(dense, (np.arange(len(points))[:, None], mesh.joints[corners].reshape(len(points), -1)), values)
    return NearestWeights(np.broadcast_to(np.arange(count), dense.shape), dense, near.distance)


def nearest_on(vertices: F64, faces: NDArray[np.integer], points: F64) -> NearestPoints:
    """Return the places on triangles ``faces`` [F, 3] that are nearest to ``points`` [N, 3]."""
    if not len(points):
        return NearestPoints(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp), np.zeros((0, 3)))
    surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    at, distance, face = _nearest_on(surface, points)
    bary = trimesh.triangles.points_to_barycentric(surface.triangles[face], at)
    return NearestPoints(at, distance, face, np.clip(np.nan_to_num(bary, nan=1 / 3), 0, 1))


def _nearest_on(surface: trimesh.Trimesh, points: F64) -> tuple[F64, F64, NDArray[np.intp]]:
    """Return the nearest surface point of each of ``points`` [N, 3], its distance [N] and triangle [N].

    Candidates are the triangles of the nearest samples of the surface: no spatial index of triangles is needed.
    """
    count = max(min(_SAMPLES_PER_TRIANGLE * len(surface.faces), 200_000), 4 * len(surface.faces))
    samples, of = trimesh.sample.sample_surface(surface, count, seed=0)
    tree = cKDTree(np.concatenate([samples, surface.triangles_center]), compact_nodes=False, balanced_tree=False)
    owner = np.concatenate([of, np.arange(len(surface.faces))])
    candidates = owner[tree.query(points, k=_CANDIDATES, workers=-1)[1]]  # [N, C]
    best, face = np.full(len(points), np.inf), candidates[:, 0].copy()
    at = np.zeros_like(points)
    for column in candidates.T:
        close = trimesh.triangles.closest_point(surface.triangles[column], points)
        distance = lengths(close - points)
        nearer = distance < best
        best[nearer], face[nearer], at[nearer] = distance[nearer], column[nearer], close[nearer]
    return at, best, face
