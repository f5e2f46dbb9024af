"""The fitted body as a mesh on its skeleton, standing on the floor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

__all__ = ["Dressed", "dressed_mesh"]

_DIGITS = 7  # of a metre: sums differ in their last bits with the number of threads, files should not
_SIDES = ("left", "right")
_DOWN = -0.85  # cosine; a sole turns to the floor
_LOWEST = 0.1  # share of the soles' vertices that may be mistaken


class Dressed(NamedTuple):
    """The dressed body."""

    mesh: RiggedMesh  # in the zero pose
    views: tuple[FittedView, ...]  # its surface as each picture shows it


def dressed_mesh(body: Body, fit: BodyFit) -> RiggedMesh:
    """The dressed surface in the zero pose, soles on y = 0; parts: skin, eyes, and the mouth's inside."""
    floor = np.array([0.0, _floor(body, fit), 0.0])
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), np.round(fit.joints - floor, _DIGITS))
    eye = np.isin(body.part, [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in _SIDES])
    kinds = {"skin": body.skin, "eyes": eye & ~body.skin, "mouth": ~eye & ~body.skin}
    white = np.full((2, 2, 4), 255, np.uint8)
    parts = []
    for name, vertices in kinds.items():
        mine = vertices[body.faces[:, 0]]
        parts.append(MeshPart(name, body.faces[mine], body.uv[mine], white))
    return RiggedMesh(
        np.round(fit.rest - floor, _DIGITS),
        skeleton,
        body.skin_joints.astype(np.int64),
        body.skin_weights,
        tuple(parts),
    )


def _floor(body: Body, fit: BodyFit) -> float:
    """Where the soles stand, metres; a shadow that the mask took for a shoe pulls a few vertices below it."""
    feet = np.isin(body.part, [JOINT_NAMES.index(f"{side}_{name}") for side in _SIDES for name in ("ankle", "foot")])
    down = vertex_normals(body.vertices, body.faces)[:, 1] < _DOWN
    return float(np.quantile(fit.rest[feet & down, 1], _LOWEST))
