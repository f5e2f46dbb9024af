"""Relate arms to the trunk, which they hide or which hides them, and estimate the uncertainty of a fit's limbs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.camera import Camera
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import arm_layers, forearms
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.geometry.raster import visible_faces
from glsplat.extras.authoring.geometry.surface_points import triangle_areas
from glsplat.meshes import MeshPart, RiggedMesh, vertex_normals
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

_MAX_FIGURE_PX = 300.0  # height of the person in the depth map
_MIN_DEPTH_M = 0.01  # of an arm behind the trunk's front
_MIN_VISIBILITY = 0.6  # of a wrist whose forearm lies in front of the trunk
_SAMPLES = 60  # vertices of a forearm
_MIN_INSET_FRACTION = 0.015  # of the person's height, from the trunk's outline; nearer arms may hang beside it
LIMBS: dict[str, tuple[int, ...]] = {
    "head": (0,),
    "left arm": (13, 15),
    "right arm": (14, 16),
    "left leg": (25, 27),
    "right leg": (26, 28),
}
"""Numbers of each limb's landmarks; the head's is the nose."""
_MAX_UNCERTAINTY = 0.6  # of one leg, or of the head


def distance_to_arms(
    body: Body, pixels: F64, shape: tuple[int, int], chosen: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """Return [H, W] distances in pixels to the arms, or to the ``chosen`` [V] vertices.

    ``pixels`` [V, 2] are those of the body. The mask's edge near an arm belongs to it, not to the trunk.
    """
    own = ((arm_layers(body) > 0) if chosen is None else chosen)[body.faces].all(axis=1)
    arms = projected_mask(pixels, body.faces[own], shape).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(1 - arms, cv2.DIST_L2, 3), np.float32)


def hidden_arms(body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int]) -> tuple[float, float]:
    """Return the fraction of each forearm and hand (left, right) that lies in the trunk or behind it.

    ``where`` [V, 3] is the surface in camera axes, metres, with ``pixels`` [V, 2] in a picture of ``shape`` (H, W).
    Only the surface that faces the camera counts; 0 for an arm without any.
    """
    behind = where[:, 2] > _trunk_depth(body, where, pixels, focal, shape) + _MIN_DEPTH_M
    turned = (vertex_normals(where, body.faces) * where).sum(axis=1) < 0
    arms = [(arm_layers(body) == layer) & forearms(body) & turned for layer in (1, 2)]
    left, right = (float(behind[arm].mean()) if arm.any() else 0.0 for arm in arms)
    return left, right


def before_trunk(
    body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int], visible: F64
) -> tuple[NDArray[np.intp], F64]:
    """Return vertices [K] of forearms that are visible in front of the trunk, and their largest depths [K] in metres.

    ``visible`` [2] is the visibility of the left and right wrist; for the others see ``hidden_arms``.
    """
    depth = _trunk_depth(body, where, pixels, focal, shape, _MIN_INSET_FRACTION)
    chosen = [np.zeros(0, np.intp)]
    for layer in np.flatnonzero(visible > _MIN_VISIBILITY) + 1:
        arm = np.flatnonzero((arm_layers(body) == layer) & forearms(body))
        total = np.cumsum(_areas(body)[arm])  # evenly by area: a hand has as many vertices as a leg
        arm = arm[np.unique(np.searchsorted(total, np.linspace(0, total[-1], _SAMPLES)))]
        chosen.append(arm[np.isfinite(depth[arm])])
    vertices = np.concatenate(chosen)
    return vertices, depth[vertices]


def _trunk_depth(body: Body, where: F64, pixels: F64, focal: float, shape: tuple[int, int], within: float = 0.0) -> F64:
    """Return the trunk's depth [V] in metres at each vertex's pixel; see ``hidden_arms``.

    Infinite beside the trunk and nearer to its outline than ``within``, a fraction of the person's height.
    """
    scale = min(_MAX_FIGURE_PX / max(float(np.ptp(pixels[:, 1])), 1.0), 1.0)
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
    """Return the surface area [V] of each vertex, square metres."""
    area = triangle_areas(body.vertices, body.faces) / 3
    return np.asarray(np.bincount(body.faces.ravel(), np.repeat(area, 3), len(body.vertices)), np.float64)


@lru_cache(maxsize=1)
def _trunk(body: Body) -> RiggedMesh:
    own = (arm_layers(body)[body.faces] == 0).any(axis=1)
    part = MeshPart("trunk", body.faces[own], body.uv[own], np.full((1, 1, 4), 255, np.uint8))
    skeleton = Skeleton.from_joints(JOINT_NAMES, list(PARENTS), body.joints)
    return RiggedMesh(body.vertices, skeleton, body.skin_joints.astype(np.int64), body.skin_weights, (part,))


def limb_uncertainty(view: View, hidden: tuple[float, float]) -> dict[str, float]:
    """Return the uncertainty of each limb, from 0 (fully visible) to 1 (a guess).

    It is 1 minus the visibility of the limb's least visible landmark; for an arm at least the fraction ``hidden``
    (left, right) behind the trunk.
    """
    uncertainty = {limb: float(1 - view.visibility[list(marks)].min()) for limb, marks in LIMBS.items()}
    for limb, share in zip(("left arm", "right arm"), hidden, strict=True):
        uncertainty[limb] = max(uncertainty[limb], share)
    return uncertainty


def missing_part(uncertainty: Mapping[str, float], side: str) -> str:
    """Return one line that names a part of the person that the ``side`` picture does not show, or an empty one."""
    if min(uncertainty.get(f"{each} leg", 0.0) for each in ("left", "right")) > _MAX_UNCERTAINTY:
        return f"the legs are not seen in the {side} picture"
    if side == "front" and uncertainty.get("head", 0.0) > _MAX_UNCERTAINTY:
        return f"the head is not seen in the {side} picture"
    return ""
