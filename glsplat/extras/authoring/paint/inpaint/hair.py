"""Long hair has a volume of its own: it hangs from the back of the head and does not lie in the hollow of the neck."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.fit.body_fit import FittedView
from glsplat.extras.authoring.paint.head import back_of_head
from glsplat.extras.authoring.paint.lamp import Lamp
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["with_hair"]

F64 = NDArray[np.float64]

_THICK = 0.012  # metres of hair over a back
_ROUND = 0.35  # of its width: how much nearer to the front its sides are than its middle
_BESIDE = 0.06  # metres from the middle: a head is looked at there for how far it reaches back
_HEAD = 0.75  # share of the way down from crown to chin where hair begins to hang
_LEAST, _FLAT = 0.01, 0.0005  # metres: what moves less stays, as a whole and each vertex
_EVENED = 8  # times
_SHOWN = 4.0
_HEAD_JOINT = JOINT_NAMES.index("head")


def with_hair(body: Body, shots: tuple[FittedPicture, ...]) -> tuple[FittedPicture, ...]:
    """The pictures of a body on which hair that falls over neck and back, as the front shows it, hangs behind these."""
    front = shots[0]
    rest = front.mesh.vertices
    up = front.view.root[:, 1]
    head = back_of_head(body, front, Lamp(np.array([0.0, 0.0, -1.0]), up, 0.0), locks=False)
    hair = (head.covered * head.hair).clip(0, 1)
    of_head = body.skin & np.isin(body.part, [JOINT_NAMES.index(name) for name in ("head", "jaw")])
    hanging = (hair > 0) & ~of_head & body.skin
    middle = of_head & (np.abs(rest[:, 0]) < _BESIDE)
    lowest = float(rest[hanging, 1].min(initial=np.inf))
    if not middle.any() or lowest > front.mesh.skeleton.joints[JOINT_NAMES.index("neck"), 1]:
        return shots  # short hair
    top, chin = rest[of_head, 1].max(), rest[of_head, 1].min()
    begins = top - _HEAD * (top - chin)
    row = middle & (rest[:, 1] > begins)
    first = float(rest[row, 2].min()) if row.any() else float(rest[middle, 2].min())
    foot = hanging & (rest[:, 1] < lowest + 0.05)
    last = min(float(rest[foot, 2].min()) - _THICK, first + 0.08)
    share = ((begins - rest[:, 1]) / max(begins - lowest, 1e-3)).clip(0, 1)
    wide = float(np.abs(rest[hanging, 0]).max())
    bent = 1 - np.sqrt(1 - (rest[:, 0] / max(wide, 1e-3)).clip(-1, 1) ** 2)
    curtain = first + share * (last - first) + _ROUND * wide * bent
    back = np.where((hair > 0) & body.skin & (rest[:, 1] < begins), hair * np.minimum(curtain - rest[:, 2], 0), 0.0)
    if back.min() > -_LEAST:
        return shots
    near = body.neighbours
    degree = np.maximum(np.asarray(near.sum(axis=1)).ravel(), 1)
    for _ in range(_EVENED):  # hair has no folds; faces and eyes stay
        back = np.where(rest[:, 2] < float(front.mesh.skeleton.joints[_HEAD_JOINT, 2]), (near @ back) / degree, back)
    back *= (1 - _SHOWN * front.trust).clip(0, 1)  # what the picture shows stays where it is
    back[back > -_FLAT] = 0.0
    moved = rest.copy()
    moved[:, 2] += back
    mesh = replace(front.mesh, vertices=moved)
    return tuple(shot.without_view_of(mesh, _seen(mesh, shot.view, back < 0)) for shot in shots)


def _seen(mesh: RiggedMesh, view: FittedView, some: NDArray[np.bool_]) -> FittedView:
    """The view with ``some`` [V] vertices where the mesh has them now; their pixels, which are hidden, stay."""
    there = mesh.posed(Pose(view.rotations)) - mesh.skeleton.joints[0]
    return replace(view, vertices=np.where(some[:, None], there @ view.root.T + view.pelvis, view.vertices))
