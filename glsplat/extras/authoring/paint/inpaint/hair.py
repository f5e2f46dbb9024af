"""Let long hair hang from the back of the head, instead of following the hollow of the neck."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.paint.head import back_of_head, vertices_of
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_THICKNESS_M = 0.012  # of hair over a back
_CURVE_FACTOR = 0.35  # how much nearer to the front its sides are than its middle, over its half width
_HEAD_MIDDLE_M = 0.06  # on both sides of the middle: where the back of the head is measured
_HANG_FRACTION = 0.75  # of the way from crown to chin: hair hangs from here
_MAX_BACK_M = 0.08  # behind the head, at the lowest end
_LOWEST_ROW_M = 0.05
_MIN_MOVE_M, _MIN_VERTEX_MOVE_M = 0.01, 0.0005  # smaller moves are dropped: of all, and of each vertex
_SMOOTHING_ROUNDS = 8
_VISIBLE_FACTOR = 4.0  # of visibility: visible vertices keep their places
_HEAD_JOINT = JOINT_NAMES.index("head")


def with_hair(body: Body, shots: tuple[FittedPicture, ...]) -> tuple[FittedPicture, ...]:
    """Return the pictures with long hair, as the front shows it, hanging behind neck and back of the body."""
    front = shots[0]
    rest = front.mesh.vertices
    up = front.view.root[:, 1]
    head = back_of_head(body, front, Lamp(np.array([0.0, 0.0, -1.0]), up, 0.0), blended=False)
    hair = (head.covered * head.hair).clip(0, 1)
    of_head = body.skin & vertices_of(body, "head", "jaw")
    hanging = (hair > 0) & ~of_head & body.skin
    middle = of_head & (np.abs(rest[:, 0]) < _HEAD_MIDDLE_M)
    lowest = float(rest[hanging, 1].min(initial=np.inf))
    if not middle.any() or lowest > front.mesh.skeleton.joints[JOINT_NAMES.index("neck"), 1]:
        return shots  # short hair
    top, chin = rest[of_head, 1].max(), rest[of_head, 1].min()
    hang_start = top - _HANG_FRACTION * (top - chin)
    row = middle & (rest[:, 1] > hang_start)
    head_back = float(rest[row, 2].min()) if row.any() else float(rest[middle, 2].min())
    lowest_row = hanging & (rest[:, 1] < lowest + _LOWEST_ROW_M)
    curtain_back = min(float(rest[lowest_row, 2].min()) - _THICKNESS_M, head_back + _MAX_BACK_M)
    share = ((hang_start - rest[:, 1]) / max(hang_start - lowest, 1e-3)).clip(0, 1)
    wide = float(np.abs(rest[hanging, 0]).max())
    bent = 1 - np.sqrt(1 - (rest[:, 0] / max(wide, 1e-3)).clip(-1, 1) ** 2)
    curtain = head_back + share * (curtain_back - head_back) + _CURVE_FACTOR * wide * bent
    back = np.where((hair > 0) & body.skin & (rest[:, 1] < hang_start), hair * np.minimum(curtain - rest[:, 2], 0), 0.0)
    if back.min() > -_MIN_MOVE_M:
        return shots
    near = body.neighbours
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    for _ in range(_SMOOTHING_ROUNDS):  # smooths folds; faces and eyes keep their places
        back = np.where(rest[:, 2] < float(front.mesh.skeleton.joints[_HEAD_JOINT, 2]), (near @ back) / degree, back)
    back *= (1 - _VISIBLE_FACTOR * front.visibility).clip(0, 1)  # visible surface keeps its place
    back[back > -_MIN_VERTEX_MOVE_M] = 0.0
    moved = rest.copy()
    moved[:, 2] += back
    mesh = replace(front.mesh, vertices=moved)
    return tuple(shot.without_view_of(mesh, shot.view.moved(mesh, back < 0)) for shot in shots)
