"""Arms apart from the trunk: where they hide its outline, and how much of them a fit has hidden behind it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.making.fit.body import Body
from glsplat.making.fit.outline import projected_mask
from glsplat.making.raster import visible_faces
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

__all__ = ["TRUNK", "beside_arms", "forearms", "hidden_arms", "layers"]

F64 = NDArray[np.float64]

TRUNK = 0
"""In ``layers``: everything that is no arm, legs and head included. The left arm is 1 and the right one 2."""

_SIDES = ("left", "right")
_DISTAL = 0.35  # share of the upper arm that goes with the trunk, since sleeves begin there
_FOREARM = ("elbow", "wrist", "index", "middle", "pinky", "ring", "thumb")
_COARSE = 300.0  # pixels of the person's height that depths are compared with
_BEHIND = 0.01  # metres


@lru_cache(maxsize=1)
def layers(body: Body) -> NDArray[np.intp]:
    """[V] TRUNK, 1 or 2: what a picture can show one over the other."""
    out = np.full(len(body.vertices), TRUNK, np.intp)
    for layer, side in enumerate(_SIDES, 1):
        shoulder, elbow = (body.joints[JOINT_NAMES.index(f"{side}_{name}")] for name in ("shoulder", "elbow"))
        along = (body.vertices - shoulder) @ (elbow - shoulder) / ((elbow - shoulder) @ (elbow - shoulder))
        upper = _held(body, side, (*_FOREARM, "shoulder")) > 0.5
        out[(_held(body, side, _FOREARM) > 0.5) | (upper & (along > _DISTAL))] = layer
    return out


@lru_cache(maxsize=1)
def forearms(body: Body) -> NDArray[np.bool_]:
    """[V] what hangs on the elbows."""
    return np.asarray(sum(_held(body, side, _FOREARM) for side in _SIDES) > 0.5)


def _held(body: Body, side: str, parts: tuple[str, ...]) -> F64:
    """[V] how much these joints of a side hold of each vertex."""
    own = np.array([name.startswith(f"{side}_") and any(part in name for part in parts) for name in JOINT_NAMES])
    return np.asarray((body.skin_weights * own[body.skin_joints]).sum(axis=1))


def beside_arms(body: Body, pixels: F64, shape: tuple[int, int], reach: float) -> NDArray[np.bool_]:
    """[H, W] the arms of a body that lies at ``pixels`` [V, 2], and ``reach`` pixels around them.

    What a mask's edge says there is said of an arm, whether it lies before the trunk, behind it or along it.
    """
    own = (layers(body)[body.faces] != TRUNK).all(axis=1)
    arms = projected_mask(pixels, body.faces[own], shape).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(1 - arms, cv2.DIST_L2, 3) <= reach)


def hidden_arms(body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int]) -> tuple[float, float]:
    """Share of each forearm with its hand that lies in the trunk or behind it, left and right, 0 to 1.

    ``where`` [V, 3] is the surface in camera axes, metres, which a picture of ``shape`` has at ``pixels`` [V, 2]. Of
    what turns to the camera; an arm that turns nothing there has nothing to hide.
    """
    scale = min(_COARSE / max(float(np.ptp(pixels[:, 1])), 1.0), 1.0)
    height, width = (max(round(side * scale), 1) for side in shape)
    x, y = (pixels - where[:, :2] / where[:, 2:] * focal).mean(axis=0) * scale
    trunk = _trunk(body)
    camera = Camera(np.eye(4), [[focal * scale, 0, x], [0, focal * scale, y], [0, 0, 1]], width, height)
    faces, weights = visible_faces(trunk, where, camera)
    depth = np.full(faces.shape, np.inf)
    hit = faces >= 0
    depth[hit] = (weights[hit] * where[trunk.faces[faces[hit]], 2]).sum(axis=1)
    turned = (vertex_normals(where, body.faces) * where).sum(axis=1) < 0
    column, row = np.floor(pixels * scale).astype(int).T
    behind = where[:, 2] > depth[row.clip(0, height - 1), column.clip(0, width - 1)] + _BEHIND
    arms = [behind[(layers(body) == layer) & forearms(body) & turned] for layer in (1, 2)]
    left, right = (float(arm.mean()) if len(arm) else 0.0 for arm in arms)
    return left, right


@lru_cache(maxsize=1)
def _trunk(body: Body) -> RiggedMesh:
    own = (layers(body)[body.faces] == TRUNK).any(axis=1)
    part = MeshPart("trunk", body.faces[own], body.uv[own], np.full((1, 1, 4), 255, np.uint8))
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), body.joints)
    return RiggedMesh(body.vertices, skeleton, body.skin_joints.astype(np.int64), body.skin_weights, (part,))
