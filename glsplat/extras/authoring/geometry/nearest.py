"""The points of a mesh nearest to given ones, and the skinning weights there."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.meshes import RiggedMesh
from glsplat.rotations import lengths

__all__ = ["nearest_on", "nearest_weights"]

F64 = NDArray[np.float64]

_CANDIDATES = 8


def nearest_weights(mesh: RiggedMesh, points: F64) -> tuple[NDArray[np.int64], F64, F64]:
    """Joints and weights [N, J] of the surface points nearest to ``points`` [N, 3], and their distances [N]."""
    _, distance, face, bary = nearest_on(mesh.vertices, mesh.faces, points)
    corners = mesh.faces[face]
    count = len(mesh.skeleton)
    dense = np.zeros((len(points), count))  # the three corners may share joints
    values = (bary[:, :, None] * mesh.weights[corners]).reshape(len(points), -1)
    np.add.at(dense, (np.arange(len(points))[:, None], mesh.joints[corners].reshape(len(points), -1)), values)
    return np.broadcast_to(np.arange(count), dense.shape), dense, distance


def nearest_on(vertices: F64, faces: NDArray[np.integer], points: F64) -> tuple[F64, F64, NDArray[np.intp], F64]:
    """Of triangles [F, 3] the places nearest to ``points`` [N, 3]: where, how far, in which, barycentric [N, 3]."""
    if not len(points):
        return np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp), np.zeros((0, 3))
    surface = trimesh.Trimesh(vertices, faces, process=False, validate=False)
    at, distance, face = _nearest_on(surface, points)
    bary = trimesh.triangles.points_to_barycentric(surface.triangles[face], at)
    return at, distance, face, np.clip(np.nan_to_num(bary, nan=1 / 3), 0, 1)


def _nearest_on(surface: trimesh.Trimesh, points: F64) -> tuple[F64, F64, NDArray[np.intp]]:
    """Nearest surface point of each of ``points`` [N, 3], its distance [N] and triangle [N].

    Triangles are looked for around the nearest of many samples, which spares a spatial index of triangles.
    """
    count = max(200_000, 4 * len(surface.faces))
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
