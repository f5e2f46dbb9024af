"""Arms apart from the trunk: where they hide its outline, and how much of them a fit has hidden behind it."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import HANDS, arm_layers, forearms, joint_weights
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import triangle_areas
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

__all__ = ["before_trunk", "beside_arms", "hands", "hidden_arms"]

F64 = NDArray[np.float64]

_COARSE = 300.0  # pixels of the person's height that depths are compared with
_BEHIND = 0.01  # metres
_SHOWN = 0.6  # visibility of a wrist from which on its forearm is taken to lie before the trunk
_SOME = 60  # of a forearm's vertices
_WITHIN = 0.015  # of the person's height that it lies within the trunk's outline; nearer to it an arm may hang beside


@lru_cache(maxsize=1)
def hands(body: Body) -> NDArray[np.bool_]:
    """Return a mask [V] of the hands."""
    return np.asarray(sum(joint_weights(body, side, *HANDS) for side in ("left", "right")) > 0.5)


def beside_arms(
    body: Body, pixels: F64, shape: tuple[int, int], reach: float, some: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """[H, W] the arms of a body that lies at ``pixels`` [V, 2], or ``some`` [V] of it, and ``reach`` pixels around.

    What a mask's edge says there is said of an arm, whether it lies before the trunk, behind it or along it.
    """
    own = ((arm_layers(body) > 0) if some is None else some)[body.faces].all(axis=1)
    arms = projected_mask(pixels, body.faces[own], shape).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(1 - arms, cv2.DIST_L2, 3) <= reach)


def hidden_arms(body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int]) -> tuple[float, float]:
    """Share of each forearm with its hand that lies in the trunk or behind it, left and right, 0 to 1.

    ``where`` [V, 3] is the surface in camera axes, metres, which a picture of ``shape`` has at ``pixels`` [V, 2]. Of
    what turns to the camera; an arm that turns nothing there has nothing to hide.
    """
    behind = where[:, 2] > _trunk_depth(body, where, pixels, focal, shape) + _BEHIND
    turned = (vertex_normals(where, body.faces) * where).sum(axis=1) < 0
    arms = [(arm_layers(body) == layer) & forearms(body) & turned for layer in (1, 2)]
    left, right = (float(behind[arm].mean()) if arm.any() else 0.0 for arm in arms)
    return left, right


def before_trunk(
    body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int], visible: F64
) -> tuple[NDArray[np.intp], F64]:
    """Vertices [K] of forearms that a picture shows over the trunk, and metres [K] of depth that they may have there.

    ``visible`` [2] is how well the left wrist and the right one are seen; the others as in ``hidden_arms``.
    """
    depth = _trunk_depth(body, where, pixels, focal, shape, _WITHIN)
    chosen = [np.zeros(0, np.intp)]
    for layer in np.flatnonzero(visible > _SHOWN) + 1:
        arm = np.flatnonzero((arm_layers(body) == layer) & forearms(body))
        total = np.cumsum(_areas(body)[arm])  # a hand has as many vertices as a leg
        arm = arm[np.unique(np.searchsorted(total, np.linspace(0, total[-1], _SOME)))]
        chosen.append(arm[np.isfinite(depth[arm])])
    vertices = np.concatenate(chosen)
    return vertices, depth[vertices]


def _trunk_depth(body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int], within: float = 0.0) -> F64:
    """[V] metres of depth that the trunk has at each vertex's pixel, infinite beside it; see ``hidden_arms``.

    Infinite, too, nearer to its outline than ``within``, a share of the person's height.
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
    if within:
        inside = cv2.distanceTransform(hit.astype(np.uint8), cv2.DIST_L2, 3)
        depth[inside < within * float(np.ptp(pixels[:, 1])) * scale] = np.inf
    column, row = np.floor(pixels * scale).astype(int).T
    return np.asarray(depth[row.clip(0, height - 1), column.clip(0, width - 1)])


@lru_cache(maxsize=1)
def _areas(body: Body) -> F64:
    """[V] square metres of the surface around each vertex."""
    area = triangle_areas(body.vertices, body.faces) / 3
    return np.asarray(np.bincount(body.faces.ravel(), np.repeat(area, 3), len(body.vertices)), np.float64)


@lru_cache(maxsize=1)
def _trunk(body: Body) -> RiggedMesh:
    own = (arm_layers(body)[body.faces] == 0).any(axis=1)
    part = MeshPart("trunk", body.faces[own], body.uv[own], np.full((1, 1, 4), 255, np.uint8))
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), body.joints)
    return RiggedMesh(body.vertices, skeleton, body.skin_joints.astype(np.int64), body.skin_weights, (part,))
