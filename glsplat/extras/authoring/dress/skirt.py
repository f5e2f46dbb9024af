"""A skirt is one surface: between the legs it hangs from both, and follows the mean of them.

The body has no cloth between its legs. Where the picture has cloth there down to a hem, the inner halves of both legs
become one sheet before and one behind, from the middle of one leg to that of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.dress.fitted_mesh import Dressed, dressed_mesh
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import fully_posed, projected
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.view import View
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["dress", "hem_of", "with_skirt"]

F64 = NDArray[np.float64]

_LEGS = ("hip", "knee", "ankle")
_GAP, _FILLED = 0.012, 0.97  # of the person's height between bare legs; of it, what a skirt covers
_HEM = 0.04  # of the height between the legs at a hem; the gap of trousers begins narrow
_LENGTH = 0.06  # of the person's height: shorter ones are the cut of trousers
_GOWN = 0.25  # of the height that a gown to the floor covers between the legs
_ROW = 0.02  # metres of height
_SOFT = 0.10  # metres below the crotch in which legs become a sheet
_WALL = np.radians(25)  # about a leg's inmost line: where front and back of the sheet meet
_REACH = 1.8  # halves of the distance between the legs over which one leg's pull becomes the other's


def dress(body: Body, fit: BodyFit, views: Sequence[View]) -> Dressed:
    """Return the fitted body as a mesh, with a skirt where the first of ``views``, the front, shows one."""
    dressed = Dressed(dressed_mesh(body, fit), fit.views)
    hem = hem_of(body, fit, dressed.mesh, views[0])
    return dressed if hem is None else with_skirt(body, dressed, views, hem)


def hem_of(body: Body, fit: BodyFit, mesh: RiggedMesh, view: View) -> float | None:
    """Metres of height in the zero pose of the ``mesh`` where a skirt ends in the front ``view``; None without one.

    A skirt covers the gap between bare legs from the crotch down to its hem, and not beyond; a gown all of it, where
    the legs beneath are apart down to the ankles. Of legs that stand together nothing tells a gown from trousers.
    """
    seen = fit.views[0]
    posed = fully_posed(body, fit.betas, seen.root, seen.pelvis, seen.rotations)
    bare = posed.points(body.points(np.arange(len(body.vertices))))
    pixels = projected(bare, view.focal, view.centre)[0]
    legs = [
        projected_mask(pixels, body.faces[_leg(body, side)[body.faces].all(axis=1)], view.mask.shape)
        for side in ("left", "right")
    ]
    columns = np.arange(view.mask.shape[1])
    filled = []  # row, width of the gap, share of it
    for row in range(view.mask.shape[0]):
        ends = [columns[leg[row]] for leg in legs]
        if not len(ends[0]) or not len(ends[1]):
            continue
        low, high = sorted(ends, key=lambda end: float(end.mean()))
        gap = slice(int(low[-1]) + 1, int(high[0]))
        if gap.stop - gap.start > _GAP * view.figure:
            filled.append((row, gap.stop - gap.start, float(view.mask[row, gap].mean())))
    if not filled:
        return None
    rows, wide, share = (np.array(column) for column in zip(*filled, strict=True))
    bared = share < 0.5
    gown = not bared.any()  # cloth down to the ankles, between legs that are apart all the way
    last = len(rows) - 1 if gown else int(bared.argmax())
    apart, length = (wide[-(len(wide) // 4 + 1) :].min(), _GOWN) if gown else (wide[last], _LENGTH)
    if (
        last == 0
        or share[:last].mean() < _FILLED
        or apart < _HEM * view.figure
        or rows[last] - rows[0] < length * view.figure
    ):
        return None
    near = (_leg(body, "left") | _leg(body, "right")) & (np.abs(pixels[:, 1] - rows[last]) < 0.01 * view.figure)
    return float(np.median(mesh.vertices[near, 1])) if near.any() else None


def with_skirt(body: Body, dressed: Dressed, views: Sequence[View], hem: float) -> Dressed:
    """Return the dressed body with a skirt down to ``hem``, metres of height in the zero pose."""
    mesh = dressed.mesh
    rest, joints = mesh.vertices.copy(), mesh.skeleton.joints
    inner = rest.copy()
    worn = np.zeros(len(rest))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg = _leg(body, side)
        line = joints[[JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS]][::-1]
        crotch = float(np.quantile(rest[leg, 1], 0.98))
        share = ((crotch - rest[:, 1]) / _SOFT).clip(0, 1) * (rest[:, 1] > hem) * leg
        middle = sign * np.interp(rest[:, 1], line[:, 1], line[:, 0])
        back, front = _depths(rest, leg)
        centre = (back + front) / 2
        across, away = middle - sign * rest[:, 0], rest[:, 2] - centre
        angle = np.arctan2(np.abs(away), across)  # 0 inmost, a right angle before or behind the leg's middle
        flat = np.minimum(angle / _WALL, 1)
        angle = ((angle - _WALL) / (np.pi / 2 - _WALL)).clip(0, 1)
        sheet = (across > 0) & leg
        depth = np.where(away > 0, front, back)
        inner[sheet, 0] = (middle * angle)[sheet]
        inner[sheet, 2] = (centre + flat * (depth - centre))[sheet]
        rest[sheet] += share[sheet, None] * (inner - rest)[sheet]
        worn = np.maximum(worn, share)
    apart = abs(joints[JOINT_NAMES.index("left_knee"), 0] - joints[JOINT_NAMES.index("right_knee"), 0])
    left = 0.5 + 0.5 * (rest[:, 0] / (_REACH * apart / 2)).clip(-1, 1)
    weights = np.zeros((len(rest), len(JOINT_NAMES)))
    np.put_along_axis(weights, mesh.joints, mesh.weights, axis=1)
    for name in _LEGS[:2]:
        pair = [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")]
        total = weights[:, pair].sum(axis=1)
        wanted = total[:, None] * np.stack([left, 1 - left], axis=1)
        weights[:, pair] += worn[:, None] * (wanted - weights[:, pair])
    strongest = np.sort(np.argsort(-weights, axis=1, kind="stable")[:, : mesh.joints.shape[1]], axis=1)
    kept = np.take_along_axis(weights, strongest, axis=1)
    made = replace(mesh, vertices=rest, joints=strongest, weights=kept / kept.sum(axis=1, keepdims=True))
    seen = (_moved(made, view, fitted, worn > 0) for view, fitted in zip(views, dressed.views, strict=True))
    return Dressed(made, tuple(seen))


def _moved(mesh: RiggedMesh, view: View, fitted: FittedView, some: NDArray[np.bool_]) -> FittedView:
    """The view with ``some`` [V] vertices where the mesh has them now."""
    there = mesh.posed(Pose(fitted.rotations)) - mesh.skeleton.joints[0]
    vertices = np.where(some[:, None], there @ fitted.root.T + fitted.pelvis, fitted.vertices)
    return replace(fitted, vertices=vertices, pixels=projected(vertices, view.focal, view.centre)[0])


def _depths(rest: F64, leg: NDArray[np.bool_]) -> tuple[F64, F64]:
    """[V] z of a leg's back and front at each vertex's height."""
    row = np.round(rest[:, 1] / _ROW).astype(np.intp)
    row -= row.min()
    out = []
    for sign in (-1.0, 1.0):
        most = np.full(row.max() + 3, -np.inf)
        np.maximum.at(most, row[leg] + 1, sign * rest[leg, 2])
        known = np.flatnonzero(np.isfinite(most))
        most = np.interp(np.arange(len(most)), known, most[known])
        out.append(sign * ((most[:-2] + most[1:-1] + most[2:]) / 3)[row])
    return out[0], out[1]


def _leg(body: Body, side: str) -> NDArray[np.bool_]:
    """[V] the vertices of one leg, without its foot."""
    return np.isin(body.part, [JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS[:2]])
