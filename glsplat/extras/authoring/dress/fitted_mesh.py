"""Build the fitted body's mesh on its skeleton, standing on the floor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

_DECIMALS_M = 7  # so that files do not depend on the last bits of sums
_SIDES = ("left", "right")
_MAX_SOLE_NORMAL_Y = -0.85  # soles face the floor
_FLOOR_QUANTILE = 0.1  # of the soles' heights: a shadow taken for a shoe pulls a few vertices below the floor


class Dressed(NamedTuple):
    """The dressed body: its mesh in the zero pose, and its surface in each picture."""

    mesh: RiggedMesh
    views: tuple[FittedView, ...]


def dressed_mesh(body: Body, fit: BodyFit) -> RiggedMesh:
    """Return the dressed surface in the zero pose, soles on y = 0; its parts are skin, eyes and mouth."""
    floor = np.array([0.0, _floor(body, fit), 0.0])
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), np.round(fit.joints - floor, _DECIMALS_M))
    eye = np.isin(body.part, [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in _SIDES])
    kinds = {"skin": body.skin, "eyes": eye & ~body.skin, "mouth": ~eye & ~body.skin}
    white = np.full((2, 2, 4), 255, np.uint8)
    parts = []
    for name, vertices in kinds.items():
        chosen = vertices[body.faces[:, 0]]
        parts.append(MeshPart(name, body.faces[chosen], body.uv[chosen], white))
    return RiggedMesh(
        np.round(fit.rest - floor, _DECIMALS_M),
        skeleton,
        body.skin_joints.astype(np.int64),
        body.skin_weights,
        tuple(parts),
    )


def _floor(body: Body, fit: BodyFit) -> float:
    """Return the height of the soles in metres."""
    feet = np.isin(body.part, [JOINT_NAMES.index(f"{side}_{name}") for side in _SIDES for name in ("ankle", "foot")])
    down = vertex_normals(body.vertices, body.faces)[:, 1] < _MAX_SOLE_NORMAL_Y
    return float(np.quantile(fit.rest[feet & down, 1], _FLOOR_QUANTILE))
