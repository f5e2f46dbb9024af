"""Measure the ambient occlusion of a mesh's vertices: the cosine-weighted fraction of the sky left open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from glsplat.arrays import F64
from glsplat.camera import Camera, look_at
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.visibility import sphere
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import component_sums

_DIRECTIONS = 48
_CAMERA_DISTANCE_M = 60.0  # nearly parallel rays
_DEPTH_MAP_PX = 320
_SMOOTHING_ROUNDS = 5
_NORMAL_BIAS_M = 0.012  # moves a point off its own surface
_DEPTH_TOLERANCE_M = 0.004  # behind the nearest surface
_MARGIN_M = 0.05  # around the mesh in a depth map


def ambient_occlusion(mesh: RiggedMesh, vertices: F64, directions: int = _DIRECTIONS) -> F64:
    """Return [V] from 0, hidden, to 1, open, for a mesh whose ``vertices`` [V, 3] are posed; deterministic.

    Each direction of a Fibonacci lattice is one depth map; a vertex is tested slightly off its surface.
    """
    normals = vertex_normals(vertices, mesh.faces)
    arriving, whole = np.zeros(len(vertices)), np.zeros(len(vertices))
    sky = sphere(directions)
    for direction, lit in zip(sky, map_threads(lambda way: _lit_from(mesh, vertices, way, normals), sky), strict=True):
        cosine = np.maximum(normals @ direction, 0)
        arriving += cosine * lit
        whole += cosine
    return _smoothed(mesh, np.asarray(arriving / np.maximum(whole, 1e-9)))


def _smoothed(mesh: RiggedMesh, values: F64) -> F64:
    """Return ``values`` [V] averaged over the surface: depth maps are coarser than a triangle."""
    faces = mesh.faces
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    near = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(values),) * 2)
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    for _ in range(_SMOOTHING_ROUNDS):
        values = 0.5 * values + 0.5 * (near @ values) / degree
    return values


def _lit_from(mesh: RiggedMesh, vertices: F64, direction: F64, normals: F64) -> NDArray[np.bool_]:
    """Return [V] whether distant light from the unit ``direction`` [3] reaches each vertex unoccluded."""
    size, middle = _DEPTH_MAP_PX, (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max()) + _MARGIN_M
    focal = size / 2 * _CAMERA_DISTANCE_M / radius
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    camera = Camera(look_at(middle + _CAMERA_DISTANCE_M * direction, middle), K, size, size)
    ids, bary = visible_faces(mesh, vertices, camera)
    depth = np.full(ids.shape, np.inf)
    hit = ids >= 0
    distance = vertices @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    depth[hit] = component_sums(bary[hit] * distance[mesh.faces[ids[hit]]])
    where = (vertices + _NORMAL_BIAS_M * normals) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    pixel = np.floor(focal * where[:, :2] / where[:, 2:] + size / 2).astype(np.intp).clip(0, size - 1)
    return np.asarray(depth[pixel[:, 1], pixel[:, 0]] + _DEPTH_TOLERANCE_M > where[:, 2])
