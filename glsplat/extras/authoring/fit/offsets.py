"""Offset the fitted body's surface by clothes and hair, so that its outline meets the mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import diags

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.compute.solvers import conjugate_gradients
from glsplat.meshes import vertex_normals
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

OFFSET_RANGE_M = -0.03, 0.12
"""Limits of the offsets, inwards and outwards."""

# metres, by parts of joints' names: hands wear nothing, shoes have soles
_MAX_OFFSET_M = {
    "index": 0.006,
    "middle": 0.006,
    "pinky": 0.006,
    "ring": 0.006,
    "thumb": 0.006,
    "wrist": 0.012,
    "foot": 0.03,
}
# weights relative to that of a vertex on the outline
_SMOOTHNESS_WEIGHT = 0.12  # of equal offsets of neighbours
_ZERO_WEIGHT = 2e-3  # of a zero offset
_HAIR_ZERO_WEIGHT = 3e-4  # the same under hair, which is about as thick behind as beside the face

# in the zero pose
_EAR_Z_M = 0.06  # the head behind it has smoothed directions
_FACE_MIN_Z_M, _FACE_MAX_Y_M = 0.08, 0.94
_MAX_SOLE_NORMAL_Y = -0.5  # soles face the floor
_SMOOTHING_ROUNDS = 20  # of directions


def offset_directions(body: Body, bare: F64) -> F64:
    """Return the unit directions [V, 3] of offsets from the surface ``bare`` [V, 3] in the zero pose.

    They are the normals, smoothed on the head behind the face, so that ears under hair move as a whole, and on toes,
    so that a shoe's cap stays smooth.
    """
    normals = vertex_normals(bare, body.faces)
    folded = (body.part == JOINT_NAMES.index("head")) & body.skin & (body.vertices[:, 2] < _EAR_Z_M)
    folded |= np.isin(body.part, [JOINT_NAMES.index(f"{side}_foot") for side in ("left", "right")])
    shares = 1 / np.asarray(body.neighbours.sum(axis=1)).ravel()[folded]
    near = diags(shares) @ body.neighbours[folded]
    for _ in range(_SMOOTHING_ROUNDS):
        normals[folded] = near @ normals
    return unit_vectors(normals, 1e-30)


def face_vertices(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of the face, which wears nothing and has a folded outline from the side."""
    head = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "jaw")])
    return np.asarray(head & (body.vertices[:, 2] > _FACE_MIN_Z_M) & (body.vertices[:, 1] < _FACE_MAX_Y_M))


def sole_vertices(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of the soles."""
    feet = [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in ("ankle", "foot")]
    down = vertex_normals(body.vertices, body.faces)[:, 1] < _MAX_SOLE_NORMAL_Y
    return np.asarray(np.isin(body.part, feet) & down)


def smooth_offsets(body: Body, vertices: NDArray[np.intp], wanted: F64, start: F64 | None = None) -> F64:
    """Return offsets [V] in metres that are close to ``wanted`` [K] at ``vertices`` [K] and smooth elsewhere.

    ``start`` [V] is a first guess.
    """
    limits = [
        next((limit for part, limit in _MAX_OFFSET_M.items() if part in name), OFFSET_RANGE_M[1])
        for name in JOINT_NAMES
    ]
    most = np.array(limits)[body.part]
    least = np.maximum(OFFSET_RANGE_M[0], -most)
    pull, target = np.zeros(len(body.vertices)), np.zeros(len(body.vertices))
    np.add.at(pull, vertices, 1.0)
    np.add.at(target, vertices, wanted.clip(least[vertices], most[vertices]))
    degree = np.asarray(body.neighbours.sum(axis=1)).ravel()
    head = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("neck", "head")])
    hair = head & body.skin & (body.vertices[:, 2] < _EAR_Z_M)
    scale = pull + _SMOOTHNESS_WEIGHT * degree + np.where(hair, _HAIR_ZERO_WEIGHT, _ZERO_WEIGHT)
    matrix = diags(scale) - _SMOOTHNESS_WEIGHT * body.neighbours
    begin = np.zeros(len(target)) if start is None else start
    offsets = conjugate_gradients(matrix.tocsr(), target[:, None], begin[:, None])[:, 0]
    return np.asarray(np.where(body.skin, offsets, 0.0).clip(least, most))
