"""Smooth the fitted body's normals where clothes and shoes hide its detail, such as toes and a navel."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, csr_matrix, diags

from glsplat.arrays import F64
from glsplat.extras.authoring.body.segments import HANDS
from glsplat.extras.authoring.compute.conjugate_gradients import conjugate_gradients
from glsplat.extras.authoring.geometry.visibility import HEAD
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.rotations import unit_vectors
from glsplat.skinning.skin import strongest_joint

_CLOTH_SMOOTHING_M, _NECK_SMOOTHING_M, _BARE_SMOOTHING_M = 0.03, 0.01, 0.002  # bare: faces and hands
_MAX_COTANGENT = 20.0


def cloth_normals(mesh: RiggedMesh, poses: list[F64]) -> list[F64]:
    """Return [V, 3] unit normals of the ``mesh`` for each array of vertices in ``poses``, smoothed under clothes.

    It is one implicit step of diffusion over the surface, independent of its triangles (Desbrun et al., Implicit
    Fairing of Irregular Meshes using Diffusion and Curvature Flow, 1999; cotangents after Pinkall and Polthier, 1993).
    """
    stiff, area = _laplacian(mesh)
    part = strongest_joint(mesh.joints, mesh.weights)
    sigma_m = np.full(len(part), _CLOTH_SMOOTHING_M)
    for words, smoothing in ((("neck",), _NECK_SMOOTHING_M), ((*HEAD, *HANDS), _BARE_SMOOTHING_M)):
        mine = [index for index, name in enumerate(mesh.skeleton.names) if any(word in name for word in words)]
        sigma_m[np.isin(part, mine)] = smoothing
    own = (area / sigma_m**2)[:, None]
    normals = np.concatenate([vertex_normals(vertices, mesh.faces) for vertices in poses], axis=1)
    smoothed = conjugate_gradients(csr_matrix(stiff + diags(own[:, 0])), own * normals, normals)
    return [unit_vectors(one) for one in np.split(smoothed, len(poses), axis=1)]


def _laplacian(mesh: RiggedMesh) -> tuple[csr_array, F64]:
    """Return [V, V] the cotangent matrix of the zero pose, which maps constants to 0, and [V] vertex areas."""
    corner, count = mesh.vertices[mesh.faces], len(mesh.vertices)
    rows, columns, values, area = [], [], [], np.full(count, 1e-10)
    for here in range(3):
        first, last = (here + 1) % 3, (here + 2) % 3
        one, other = corner[:, first] - corner[:, here], corner[:, last] - corner[:, here]
        across = np.linalg.norm(np.cross(one, other), axis=1)
        half = (np.einsum("fc,fc->f", one, other) / np.maximum(across, 1e-10)).clip(0, _MAX_COTANGENT) / 2
        ends = mesh.faces[:, first], mesh.faces[:, last]
        rows += [*ends, *ends]
        columns += [*ends[::-1], *ends]
        values += [-half, -half, half, half]
        np.add.at(area, mesh.faces[:, here], across / 6)
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return csr_array(entries, shape=(count, count)), area
