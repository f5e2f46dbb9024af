"""Turn the inner halves of the legs into a skirt or the back of a coat, which follow both legs.

The body has no cloth between its legs. If the picture shows cloth there down to a hem, the inner halves of both legs
become one sheet in front and one behind, from the middle of one leg to the middle of the other. An open coat has the
one behind. Behind, cloth hangs straight down from the seat.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.dress.coat import coat_hem
from glsplat.extras.authoring.dress.fitted_mesh import Dressed, dressed_mesh
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import fully_posed, projected
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.view import View
from glsplat.meshes import RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_LEGS = ("hip", "knee", "ankle")
# fractions of the person's height in the picture
_MIN_GAP_FRACTION = 0.012  # width between bare legs of a row that counts
_MIN_HEM_GAP_FRACTION = 0.04  # width between the legs at a hem; the gap of trousers begins narrow
_MIN_SKIRT_FRACTION = 0.06  # length of the covered gap; a shorter one is the cut of trousers
_MIN_GOWN_FRACTION = 0.25  # the same for a gown to the floor
_MIN_COVERED_FRACTION = 0.97  # of the gap, by a skirt

_ROW_M = 0.02
_BLEND_M, _COAT_BLEND_M = 0.10, 0.04  # below the crotch, where legs become a sheet
_TAPER_M = 0.15  # above a skirt's hem, where it draws near the legs
_SEAM_RAD = np.radians(25)  # around a leg's innermost line, where front and back of the sheet meet
_WEIGHT_BLEND_FACTOR = 1.8  # width over which weights pass from leg to leg, in distances between the knees


def dress(body: Body, fit: BodyFit, views: Sequence[View], rgb: NDArray[np.uint8]) -> Dressed:
    """Return the fitted body as a mesh, with a skirt or a coat where the first of ``views``, the front, shows one.

    ``rgb`` [H, W, 3] is the front's picture.
    """
    dressed = Dressed(dressed_mesh(body, fit), fit.views)
    skirt = hem_of(body, fit, dressed.mesh, views[0])
    hem = coat_hem(body, dressed, rgb, views[0].mask) if skirt is None else skirt
    return dressed if hem is None else with_skirt(body, dressed, views, hem, open_front=skirt is None)


def hem_of(body: Body, fit: BodyFit, mesh: RiggedMesh, view: View) -> float | None:
    """Return the height in metres of the hem in the zero pose of ``mesh``, or None if the front ``view`` has no skirt.

    A skirt covers the gap between the bare legs from the crotch to its hem and ends there. A gown covers the gap down
    to the ankles. A gown over legs without a gap cannot be told from trousers.
    """
    front = fit.views[0]
    posed = fully_posed(body, fit.betas, front.root, front.pelvis, front.rotations)
    bare = posed.points(body.points(np.arange(len(body.vertices))))
    pixels = projected(bare, view.focal, view.centre)[0]
    legs = [
        projected_mask(pixels, body.faces[_leg(body, side)[body.faces].all(axis=1)], view.mask.shape)
        for side in ("left", "right")
    ]
    columns = np.arange(view.mask.shape[1])
    gaps = []  # row, width in pixels, covered fraction
    for row in range(view.mask.shape[0]):
        ends = [columns[leg[row]] for leg in legs]
        if not len(ends[0]) or not len(ends[1]):
            continue
        low, high = sorted(ends, key=lambda end: float(end.mean()))
        gap = slice(int(low[-1]) + 1, int(high[0]))
        if gap.stop - gap.start > _MIN_GAP_FRACTION * view.figure:
            gaps.append((row, gap.stop - gap.start, float(view.mask[row, gap].mean())))
    if not gaps:
        return None
    rows, widths, covered = (np.array(column) for column in zip(*gaps, strict=True))
    bare_rows = covered < 0.5
    gown = not bare_rows.any()
    last = len(rows) - 1 if gown else int(bare_rows.argmax())
    hem_gap = widths[-(len(widths) // 4 + 1) :].min() if gown else widths[last]
    if (
        last == 0
        or covered[:last].mean() < _MIN_COVERED_FRACTION
        or hem_gap < _MIN_HEM_GAP_FRACTION * view.figure
        or rows[last] - rows[0] < (_MIN_GOWN_FRACTION if gown else _MIN_SKIRT_FRACTION) * view.figure
    ):
        return None
    near = (_leg(body, "left") | _leg(body, "right")) & (np.abs(pixels[:, 1] - rows[last]) < 0.01 * view.figure)
    return float(np.median(mesh.vertices[near, 1])) if near.any() else None


def with_skirt(body: Body, dressed: Dressed, views: Sequence[View], hem: float, open_front: bool = False) -> Dressed:
    """Return the dressed body with a skirt down to ``hem``, a height in metres in the zero pose.

    With an ``open_front`` it is a coat's back, and the legs stay in front.
    """
    mesh = dressed.mesh
    rest, joints = mesh.vertices.copy(), mesh.skeleton.joints
    _hang(body, rest, hem, 0.0 if open_front else _TAPER_M)
    inner = rest.copy()
    skirt = np.zeros(len(rest))  # 0 leg to 1 sheet
    blend = _COAT_BLEND_M if open_front else _BLEND_M
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg = _leg(body, side)
        line = joints[[JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS]][::-1]
        crotch = float(np.quantile(rest[leg, 1], 0.98))
        share = ((crotch - rest[:, 1]) / blend).clip(0, 1) * (rest[:, 1] > hem) * leg
        middle = np.interp(rest[:, 1], line[:, 1], line[:, 0])
        back, front = (sign_z * _depths(rest, leg, sign_z) for sign_z in (-1.0, 1.0))
        centre = (back + front) / 2
        across, away = sign * (middle - rest[:, 0]), rest[:, 2] - centre
        angle = np.arctan2(np.abs(away), across)  # 0 innermost, a right angle in front of or behind the leg's middle
        flat = 1.0 if open_front else np.minimum(angle / _SEAM_RAD, 1)
        angle = ((angle - _SEAM_RAD) / (np.pi / 2 - _SEAM_RAD)).clip(0, 1)
        sheet = (across > 0) & leg & ((away < 0) | (not open_front))
        depth = np.where(away > 0, front, back)
        inner[sheet, 0] = (middle * angle)[sheet]
        inner[sheet, 2] = (centre + flat * (depth - centre))[sheet]
        rest[sheet] += share[sheet, None] * (inner - rest)[sheet]
        skirt = np.maximum(skirt, share)
    knee_distance = abs(joints[JOINT_NAMES.index("left_knee"), 0] - joints[JOINT_NAMES.index("right_knee"), 0])
    left = 0.5 + 0.5 * (rest[:, 0] / (_WEIGHT_BLEND_FACTOR * knee_distance / 2)).clip(-1, 1)
    weights = np.zeros((len(rest), len(JOINT_NAMES)))
    np.put_along_axis(weights, mesh.joints, mesh.weights, axis=1)
    for name in _LEGS[:2]:
        pair = [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")]
        total = weights[:, pair].sum(axis=1)
        wanted = total[:, None] * np.stack([left, 1 - left], axis=1)
        weights[:, pair] += skirt[:, None] * (wanted - weights[:, pair])
    strongest = np.sort(np.argsort(-weights, axis=1, kind="stable")[:, : mesh.joints.shape[1]], axis=1)
    kept = np.take_along_axis(weights, strongest, axis=1)
    mesh = replace(mesh, vertices=rest, joints=strongest, weights=kept / kept.sum(axis=1, keepdims=True))
    changed = (skirt > 0) | (rest != dressed.mesh.vertices).any(axis=1)
    moved = (_moved(mesh, view, fitted, changed) for view, fitted in zip(views, dressed.views, strict=True))
    return Dressed(mesh, tuple(moved))


def _hang(body: Body, rest: F64, hem: float, taper: float) -> None:
    """Move what is behind in ``rest`` [V, 3] to where cloth hangs from the seat, less near the ``hem``."""
    for side, sign in (("left", 1.0), ("right", -1.0)):
        seat = _leg(body, side) | ((body.part == JOINT_NAMES.index("pelvis")) & (sign * rest[:, 0] > 0))
        back, front, hung = (
            -_depths(rest, seat, -1.0),
            _depths(rest, seat, 1.0),
            -_depths(rest, seat, -1.0, hanging=True),
        )
        centre, above = (back + front) / 2, rest[:, 1] - hem
        share = (above / taper).clip(0, 1) if taper else (above > 0).astype(float)
        depth = ((rest[:, 2] - centre) / np.minimum(back - centre, -0.01)).clip(0, 1)
        hanging = rest[:, 2] + share * depth * np.minimum(hung - back, 0)
        rest[seat, 2] = np.maximum(hanging, np.minimum(rest[:, 2], hung))[seat]  # rows without a vertex behind


def _moved(mesh: RiggedMesh, view: View, fitted: FittedView, chosen: NDArray[np.bool_]) -> FittedView:
    """Return the view with the ``chosen`` [V] vertices at their places in the mesh."""
    there = mesh.posed(Pose(fitted.rotations)) - mesh.skeleton.joints[0]
    vertices = np.where(chosen[:, None], there @ fitted.root.T + fitted.pelvis, fitted.vertices)
    return replace(fitted, vertices=vertices, pixels=projected(vertices, view.focal, view.centre)[0])


def _depths(rest: F64, some: NDArray[np.bool_], sign: float, hanging: bool = False) -> F64:
    """Return [V] the largest ``sign`` * z of ``some`` [V] vertices at each vertex's height, if ``hanging`` or above."""
    row = np.round(rest[:, 1] / _ROW_M).astype(np.intp)
    row -= row.min()
    most = np.full(row.max() + 3, -np.inf)
    np.maximum.at(most, row[some] + 1, sign * rest[some, 2])
    if hanging:
        most = np.maximum.accumulate(most[::-1])[::-1]
    known = np.flatnonzero(np.isfinite(most))
    most = np.interp(np.arange(len(most)), known, most[known])
    return np.asarray(((most[:-2] + most[1:-1] + most[2:]) / 3)[row])


def _leg(body: Body, side: str) -> NDArray[np.bool_]:
    """Return a mask [V] of one leg without its foot."""
    return np.isin(body.part, [JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS[:2]])
