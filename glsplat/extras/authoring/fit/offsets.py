"""Clothes and hair: how far the surface lies outside the fitted body, so that its outline meets the mask."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import diags

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.compute.conjugate_gradients import conjugate_gradients
from glsplat.meshes import vertex_normals
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["MOST", "face_of", "outward", "smooth_offsets", "soles_of"]

F64 = NDArray[np.float64]

MOST = -0.03, 0.12
"""Metres; no surface is moved farther in or out."""

_BARE = {"index": 0.006, "middle": 0.006, "pinky": 0.006, "ring": 0.006, "thumb": 0.006, "wrist": 0.012, "foot": 0.03}

_STIFF = 0.12  # how much neighbours agree against how much a vertex on the outline obeys
_SHY = 2e-3  # how much what no outline shows stays on the body

_HAIR_SHY = 3e-4  # hair is about as thick behind as beside the face

_EARS = 0.06  # metres of z in the zero pose, behind which the head's directions are smoothed
_FACE = 0.08, 0.94  # metres of z and y in the zero pose: before the one and below the other a head is face
_DOWN = -0.5  # cosine; a sole turns to the floor
_EVENED = 20  # times


def outward(body: Body, bare: F64) -> F64:
    """[V, 3] unit directions in which clothes and hair lie on the surface ``bare`` [V, 3] of the zero pose.

    They are the normals; on the head behind the face, the skull's, so that ears under hair move as a whole; on toes,
    the foot's, so that a shoe's cap does not bristle.
    """
    normals = vertex_normals(bare, body.faces)
    folded = (body.part == JOINT_NAMES.index("head")) & body.skin & (body.vertices[:, 2] < _EARS)
    folded |= np.isin(body.part, [JOINT_NAMES.index(f"{side}_foot") for side in ("left", "right")])
    shares = 1 / np.asarray(body.neighbours.sum(axis=1)).ravel()[folded]
    near = diags(shares) @ body.neighbours[folded]
    for _ in range(_EVENED):
        normals[folded] = near @ normals
    return unit_vectors(normals, 1e-30)


def face_of(body: Body) -> NDArray[np.bool_]:
    """[V] the vertices of the face: it wears nothing, and from the side its outline is full of folds."""
    head = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "jaw")])
    return np.asarray(head & (body.vertices[:, 2] > _FACE[0]) & (body.vertices[:, 1] < _FACE[1]))


def soles_of(body: Body) -> NDArray[np.bool_]:
    """[V] the vertices that somebody stands on."""
    feet = [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in ("ankle", "foot")]
    down = vertex_normals(body.vertices, body.faces)[:, 1] < _DOWN
    return np.asarray(np.isin(body.part, feet) & down)


def _hairy(body: Body) -> NDArray[np.bool_]:
    """[V] the vertices that hair may lie on: head and neck but for face and throat."""
    head = np.isin(body.part, [JOINT_NAMES.index(name) for name in ("neck", "head")])
    return np.asarray(head & body.skin & (body.vertices[:, 2] < _EARS))


def smooth_offsets(body: Body, vertices: NDArray[np.intp], wanted: F64, weights: F64, start: F64 | None = None) -> F64:
    """[V] metres along the normals: close to ``wanted`` [K] at ``vertices`` [K], the smoothest elsewhere.

    ``start`` [V] are about these, where that is known.
    """
    of_joint = [next((most for part, most in _BARE.items() if part in name), MOST[1]) for name in JOINT_NAMES]
    most = np.array(of_joint)[body.part]  # hands wear nothing, shoes have soles
    least = np.maximum(MOST[0], -most)
    pull, target = np.zeros(len(body.vertices)), np.zeros(len(body.vertices))
    np.add.at(pull, vertices, weights)
    np.add.at(target, vertices, weights * wanted.clip(least[vertices], most[vertices]))
    degree = np.asarray(body.neighbours.sum(axis=1)).ravel()
    shy = np.where(_hairy(body), _HAIR_SHY, _SHY)
    scale = pull + _STIFF * degree + shy
    matrix = diags(scale) - _STIFF * body.neighbours
    begin = np.zeros(len(target)) if start is None else start
    offsets = conjugate_gradients(matrix.tocsr(), target[:, None], begin[:, None])[:, 0]
    return np.asarray(np.where(body.skin, offsets, 0.0).clip(least, most))
