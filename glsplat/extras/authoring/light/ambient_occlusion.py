"""Ambient occlusion of a mesh's vertices: the cosine-weighted share of the sky that nothing of the mesh hides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.visibility import sphere
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import component_sums

__all__ = ["ambient_occlusion", "reached_from", "smoothed"]

F64 = NDArray[np.float64]

_DIRECTIONS = 48
_FAR = 60.0  # metres, so that rays are parallel
_SIZE = 320  # pixels of a depth map
_EVENED = 5  # rounds of averaging with the neighbours
_BIAS = 0.012  # metres along the normal that a point is looked for from, so that it does not hide itself
_DOUBT = 0.004  # metres behind the nearest surface that still count as it


def ambient_occlusion(mesh: RiggedMesh, vertices: F64, directions: int = _DIRECTIONS) -> F64:
    """[V] from 0, wholly hidden, to 1, wholly open, of a mesh whose ``vertices`` [V, 3] are posed; deterministic.

    Each direction of a Fibonacci lattice is one depth map; a vertex is looked for a little before its surface.
    """
    normals = vertex_normals(vertices, mesh.faces)
    arrives, whole = np.zeros(len(vertices)), np.zeros(len(vertices))
    ways = sphere(directions)
    for direction, open_ in zip(
        ways, map_threads(lambda way: reached_from(mesh, vertices, way, normals), ways), strict=True
    ):
        cosine = np.maximum(normals @ direction, 0)
        arrives += cosine * open_
        whole += cosine
    return smoothed(mesh, np.asarray(arrives / np.maximum(whole, 1e-9)), _EVENED)


def smoothed(mesh: RiggedMesh, values: F64, rounds: int) -> F64:
    """[V] evened out over the surface: depth maps are coarser than a face."""
    faces = mesh.faces
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    near = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(values),) * 2)
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    for _ in range(rounds):
        values = 0.5 * values + 0.5 * (near @ values) / degree
    return values


def reached_from(mesh: RiggedMesh, vertices: F64, direction: F64, normals: F64, size: int = _SIZE) -> NDArray[np.bool_]:
    """[V] whether nothing of the mesh is in the way of far light from the unit ``direction`` [3]."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max()) + 0.05
    focal = size / 2 * _FAR / radius
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    camera = Camera(look_at(middle + _FAR * direction, middle), K, size, size)
    ids, bary = visible_faces(mesh, vertices, camera)
    depth = np.full(ids.shape, np.inf)
    hit = ids >= 0
    far = vertices @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    depth[hit] = component_sums(bary[hit] * far[mesh.faces[ids[hit]]])
    where = (vertices + _BIAS * normals) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    column, row = (np.floor(focal * where[:, axis] / where[:, 2] + size / 2).astype(np.intp) for axis in range(2))
    return np.asarray(depth[row.clip(0, size - 1), column.clip(0, size - 1)] + _DOUBT > where[:, 2])
