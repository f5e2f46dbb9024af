"""The back of a head: hair as it is seen around the face, and below it the skin of the neck."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.making.fit.body import Body
from glsplat.making.paint.light import Light
from glsplat.making.paint.shot import Shot, SurfacePoints
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["back_of_head"]

F64 = NDArray[np.float64]

_CROWN = 0.12  # share of the head's height that hair is taken from
_NAPE = 0.2  # share of the head's height below which short hair ends
_STEP = 0.015  # metres of height in which hair and skin are told apart beside the face
_SOFT = 0.02  # metres over which one becomes the other
_SEEN = 0.1


def back_of_head(body: Body, shot: Shot, light: Light, points: SurfacePoints) -> tuple[F64, F64]:
    """[M] how much of each point is hair or neck that nobody looked at, and its colour [M, 3] in linear light.

    The colour is without light; ``shot`` is the front.
    """
    rest = shot.mesh.vertices
    joints = shot.mesh.skeleton.joints
    ear, nape = joints[JOINT_NAMES.index("head"), 2] + 0.02, joints[JOINT_NAMES.index("neck"), 2] + 0.02
    head = _of(body, "head", "jaw") & body.skin
    neck = _of(body, "neck")
    low, top = rest[head, 1].min(), rest[head, 1].max()
    plain = shot.sample(shot.view.pixels) / light.shade(shot.normals)[:, None]
    crown = head & (rest[:, 1] > top - _CROWN * (top - low)) & (shot.trust > _SEEN)
    throat = neck & (shot.trust > 0.5)
    if not crown.any() or not throat.any():
        return np.zeros(len(points.corners)), np.zeros((len(points.corners), 3))
    hair, skin = np.median(plain[crown], axis=0), np.median(plain[throat], axis=0)
    beside = (head | neck) & (rest[:, 2] < ear + 0.02) & (shot.trust > _SEEN)
    ends = _hair_ends(rest[beside, 1], plain[beside], hair, skin, low + _NAPE * (top - low))
    where = points.at(rest)
    above = ((where[:, 1] - ends) / _SOFT).clip(0, 1)
    on_head = points.at(head.astype(float)[:, None])[:, 0]
    on_neck = points.at(neck.astype(float)[:, None])[:, 0]
    # a sum: between head and neck a point is partly of each
    behind = _ramp(ear - where[:, 2]) * on_head + _ramp(nape - where[:, 2]) * on_neck
    covered = np.maximum(behind, _ramp(where[:, 1] - top + 0.05) * on_head)
    return np.asarray(covered), np.asarray(above[:, None] * hair + (1 - above[:, None]) * skin)


def _of(body: Body, *names: str) -> NDArray[np.bool_]:
    """[V] the vertices that these joints hold most of."""
    return np.isin(body.part, [JOINT_NAMES.index(name) for name in names])


def _ramp(metres: F64) -> F64:
    return np.asarray((metres / _SOFT).clip(0, 1))


def _hair_ends(height: F64, colours: F64, hair: F64, skin: F64, usual: float) -> float:
    """Metres above which there is hair: lower than usual where hair is seen beside the face farther down."""
    nearer = np.linalg.norm(colours - hair, axis=1) < np.linalg.norm(colours - skin, axis=1)
    lowest = usual
    while True:
        row = (height >= lowest - _STEP) & (height < lowest)
        if row.sum() < 4 or nearer[row].mean() < 0.6:
            return lowest
        lowest -= _STEP
