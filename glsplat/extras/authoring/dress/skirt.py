"""Turn hips and legs into a skirt or a coat, one surface that follows both legs.

The body has no cloth between its legs. If the picture shows cloth there down to a hem, the inner halves of both legs
become one sheet in front and one behind, from the middle of one leg to the middle of the other. Cloth hangs straight
down from belly and seat and ends in an edge. An open coat is closed in front: its gap is painted on the sheet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import hand_weights, trunk_vertices
from glsplat.extras.authoring.dress.coat import MIN_COVERED_FRACTION, coat_hem, hem_row, leg_gaps
from glsplat.extras.authoring.dress.fitted_mesh import Dressed, dressed_mesh
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import projected
from glsplat.extras.authoring.fit.offsets import offset_directions
from glsplat.extras.authoring.fit.view import View
from glsplat.meshes import RiggedMesh
from glsplat.rotations import unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

_LEGS = ("hip", "knee", "ankle")
# fractions of the person's height in the picture
_MIN_HEM_GAP_FRACTION = 0.04  # width between the legs at a hem; the gap of trousers begins narrow
_MIN_GOWN_FRACTION = 0.25  # length of the covered gap of a gown to the floor

_ROW_M = 0.03
_BLEND_M = 0.10  # above the hips, where the trunk becomes a sheet
_STRAIGHT_M = 0.08  # above a hem: the fitted surface narrows there towards the legs, cloth does not
_BARE_M = 0.10  # below a hem: the fitted surface is still as wide as the cloth above
_FRONT_QUANTILE = 0.02  # of the legs' depths in the picture
_WALL_FRACTION = 0.5  # of a leg's half depth: where its inner side faces the other leg
_MIN_OUTWARD = 0.05  # of a unit normal, in front or behind: faces of the sheet that turn away more are folds
_WEIGHT_BLEND_FACTOR = 2.6  # width over which weights pass from leg to leg, in distances between the knees


def dress(body: Body, fit: BodyFit, views: Sequence[View], rgb: NDArray[np.uint8]) -> Dressed:
    """Return the fitted body as a mesh, with a skirt or a coat where the first of ``views``, the front, shows one.

    ``rgb`` [H, W, 3] is the front's picture.
    """
    dressed = with_bare_hands(body, fit, views)
    hem = hem_of(body, fit, dressed.mesh, views[0])
    if hem is not None:  # it hangs before the legs, so it is higher than where they meet its row
        legs, where = _leg(body, "left") | _leg(body, "right"), dressed.views[0].vertices
        _, down, away = np.median(where[legs & (np.abs(dressed.mesh.vertices[:, 1] - hem) < _ROW_M)], axis=0)
        hem += float(down * (1 - np.quantile(where[legs, 2], _FRONT_QUANTILE) / away))
    else:
        hem = coat_hem(body, fit, dressed, rgb, views[0])
    if hem is None:
        return dressed
    bare = body.shaped(fit.betas)[0] - (fit.joints[0] - dressed.mesh.skeleton.joints[0])
    return with_skirt(body, bare, dressed, views, hem)


def with_bare_hands(body: Body, fit: BodyFit, views: Sequence[View]) -> Dressed:
    """Return the dressed body with hands of the body's own shape: outlines of a few pixels make fingers thorns.

    The fit itself needs those offsets, as it compares outlines.
    """
    mesh = dressed_mesh(body, fit)
    away = hand_weights(body) * body.skin * fit.offsets
    rest = mesh.vertices - away[:, None] * offset_directions(body, body.shaped(fit.betas)[0])
    mesh, moved = replace(mesh, vertices=rest), away != 0
    return Dressed(mesh, tuple(_moved(mesh, view, old, moved) for view, old in zip(views, fit.views, strict=True)))


def hem_of(body: Body, fit: BodyFit, mesh: RiggedMesh, view: View) -> float | None:
    """Return the height in metres of the hem in the zero pose of ``mesh``, or None if the front ``view`` has no skirt.

    A skirt covers the gap between the bare legs from the crotch to its hem and ends there. A gown covers the gap down
    to the ankles. A gown over legs without a gap cannot be told from trousers.
    """
    gaps = leg_gaps(body, fit, view)
    if not len(gaps):
        return None
    rows, widths, covered = gaps.T
    last = hem_row(gaps, view)
    if last is None:  # perhaps a gown
        last, long = len(rows) - 1, rows[-1] - rows[0] > _MIN_GOWN_FRACTION * view.figure
        if not long or covered.min() < 0.5 or covered.mean() < MIN_COVERED_FRACTION:
            return None
        hem_gap = widths[-(len(widths) // 4 + 1) :].min()
    else:
        hem_gap = widths[last]
    if hem_gap < _MIN_HEM_GAP_FRACTION * view.figure:
        return None
    legs = _leg(body, "left") | _leg(body, "right")
    near = legs & (np.abs(fit.views[0].pixels[:, 1] - rows[last]) < 0.01 * view.figure)
    return float(np.median(mesh.vertices[near, 1])) if near.any() else None


def with_skirt(body: Body, bare: F64, dressed: Dressed, views: Sequence[View], hem: float) -> Dressed:
    """Return the dressed body with a skirt down to ``hem``, a height in metres in the zero pose.

    ``bare`` [V, 3] is the body without clothes. The skirt ends in an edge; the legs' faces inside it are left out.
    """
    mesh = dressed.mesh
    rest, joints, height = mesh.vertices.copy(), mesh.skeleton.joints, mesh.vertices[:, 1]
    trunk, legs = trunk_vertices(body) & body.skin, {side: _leg(body, side) for side in ("left", "right")}
    worn, pelvis = trunk | legs["left"] | legs["right"], joints[JOINT_NAMES.index("pelvis"), 1]
    skirt = ((pelvis + _BLEND_M - height) / _BLEND_M).clip(0, 1) * worn * (height > hem)  # 0 leg to 1 sheet
    between = np.zeros(len(rest))  # the legs: 1 on the front of the sheet, -1 on its back
    for (side, leg), sign in zip(legs.items(), (1.0, -1.0), strict=True):
        below = leg & (height <= hem)
        rest[below] += (1 - (hem - height[below, None]) / _BARE_M).clip(0, 1) * (bare - rest)[below]
        mine = np.flatnonzero((skirt > 0) & (leg | (trunk & ((mesh.vertices[:, 0] < 0) == (sign < 0)))))
        line = joints[[JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS]][::-1]
        y, share = height[mine], skirt[mine]
        middle = sign * np.interp(y, line[:, 1], line[:, 0])
        x, z = sign * rest[mine, 0] - middle, rest[mine, 2]
        inmost, outmost, front, back = (_reach(values, y, y + _ROW_M) for values in (-x, x, z, -z))
        centre, inner = (front - back) / 2, x < 0
        sense = np.where(z > centre, 1.0, -1.0)
        round_off = np.abs(z - centre) / ((front + back) / 2)
        flare = _reach(x, y, np.maximum(y + _ROW_M, hem + _STRAIGHT_M)) / np.maximum(outmost, 0.01)
        across = middle + x * np.where(inner, middle / np.maximum(inmost, 0.01), flare)
        across[inner & (round_off < _WALL_FRACTION)] = 0
        hung = sense * np.where(sense > 0, *(_reach(values, y, y + np.inf) for values in (z, -z)))
        depth = centre + np.where(inner, 1, round_off) * (hung - centre)
        rest[mine, 0] += share * (sign * across - rest[mine, 0])
        rest[mine, 2] += share * (depth - z)
        between[mine] = sense * (inner & (share == 1))
    crossing = (np.ptp(np.sign(height - hem)[mesh.faces], axis=1) > 0) & worn[mesh.faces].all(axis=1)
    rest[np.unique(mesh.faces[crossing]), 1] = hem
    first, second, third = (rest[corner] for corner in mesh.faces.T)
    outward = unit_vectors(np.cross(second - first, third - first), 1e-30)[:, 2]
    sense = between[mesh.faces]
    inside = (sense != 0).all(axis=1) & (outward * sense.mean(axis=1) < _MIN_OUTWARD)
    parts = []
    for number, part in enumerate(mesh.parts):
        kept = ~inside[mesh.face_parts == number]
        parts.append(replace(part, faces=part.faces[kept], uv=part.uv[kept]))
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
    kept /= kept.sum(axis=1, keepdims=True)
    mesh = replace(mesh, vertices=rest, joints=strongest, weights=kept, parts=tuple(parts))
    changed = (skirt > 0) | (rest != dressed.mesh.vertices).any(axis=1)
    moved = (_moved(mesh, view, fitted, changed) for view, fitted in zip(views, dressed.views, strict=True))
    return Dressed(mesh, tuple(moved))


def _moved(mesh: RiggedMesh, view: View, fitted: FittedView, chosen: NDArray[np.bool_]) -> FittedView:
    """Return the view with the ``chosen`` [V] vertices at their places in the mesh."""
    there = fitted.moved(mesh, chosen)
    return replace(there, pixels=projected(there.vertices, view.focal, view.centre)[0])


def _reach(values: F64, height: F64, top: F64) -> F64:
    """Return [K] the largest of the ``values`` [K] from about each ``height`` [K] up to ``top`` [K], metres."""
    near = (height > height[:, None] - _ROW_M) & (height <= top[:, None])
    return np.asarray(np.where(near, values, -np.inf).max(axis=1))


def _leg(body: Body, side: str) -> NDArray[np.bool_]:
    """Return a mask [V] of one leg without its foot."""
    return np.isin(body.part, [JOINT_NAMES.index(f"{side}_{name}") for name in _LEGS[:2]])
