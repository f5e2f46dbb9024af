"""Find hems, and turn hips and legs into a skirt or a coat, one surface that follows both legs.

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
from glsplat.extras.authoring.body.segments import hand_weights, trunk_half_width, trunk_vertices
from glsplat.extras.authoring.dress.fitted_mesh import Dressed, dressed_mesh
from glsplat.extras.authoring.dress.seat import with_bridged_seat
from glsplat.extras.authoring.fit.body_fit import BodyFit, FittedView
from glsplat.extras.authoring.fit.kinematics import fully_posed, projected
from glsplat.extras.authoring.fit.offsets import face_vertices, offset_directions
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.meshes import RiggedMesh, vertex_normals
from glsplat.pictures import to_linear
from glsplat.rotations import component_sums, lengths, unit_vectors
from glsplat.skinning.smplx import JOINT_NAMES

_SAME_COLOUR_DISTANCE, _SKIN_DISTANCE = 0.15, 0.12  # square roots of linear light, shading left out
_HEM_ROW_M = 0.01  # rows of samples in which a hem is searched
_PLACES = np.array([[4, 1, 1], [1, 4, 1], [1, 1, 4], [0, 3, 3], [3, 0, 3], [3, 3, 0]]) / 6  # taken in a triangle
_MIN_COAT_M, _MIN_TROUSERS_M = 0.06, 0.1  # below the crotch to the hem, and below the hem
_HIPS_M, _CHEST_M = (-0.02, 0.12), (0.2, 0.35)  # above the hip joints
_SHINS_M = 0.08, 0.05  # above the ankles, below the knees
_OUTER_FRACTION = 0.5  # of a trunk's half width: farther outside an open coat covers it
_MIN_COSINE = 0.4  # between a seen surface and the line of sight
_MIN_SAMPLES, _MIN_ROW_SAMPLES = 12, 3
_MIN_AGREEMENT = 0.9  # of the rows that are like the coat above the hem, and like the trousers below it
_MIN_GAP_FRACTION = 0.012  # of the person's height: width of a gap between legs that counts
_HEM_FRACTION, _HEM_REACH_FRACTION = 0.025, 0.04  # of the height: of the rows of a hem; between two finds of it
_MIN_SKIRT_FRACTION = 0.03  # of the height: length of the covered gap; a shorter one is the cut of trousers
_MIN_COVERED_FRACTION = 0.97  # of the gap between the legs, by a skirt or a coat
_LEGS = ("hip", "knee", "ankle")
# fractions of the person's height in the picture
_MIN_HEM_GAP_FRACTION = 0.04  # width between the legs at a hem; the gap of trousers begins narrow
_MIN_GOWN_FRACTION = 0.25  # length of the covered gap of a gown to the floor
_ROW_M = 0.03  # rows of the sheet
_BLEND_M = 0.10  # above the hips, where the trunk becomes a sheet
_STRAIGHT_M = 0.08  # above a hem: the fitted surface narrows there towards the legs, cloth does not
_BARE_M = 0.10  # below a hem: the fitted surface is still as wide as the cloth above
_FRONT_QUANTILE = 0.02  # of the legs' depths in the picture
_WALL_FRACTION = 0.5  # of a leg's half depth: where its inner side faces the other leg
_MIN_OUTWARD = 0.05  # of a unit normal, in front or behind: faces of the sheet that turn away more are folds
_WEIGHT_BLEND_FACTOR = 2.6  # width over which weights pass from leg to leg, in distances between the knees


def unlike(look: F64, colour: F64, shading: float | F64 = 0.25) -> F64:
    """Return [M] distances of ``look`` [M, 3] from ``colour`` [M or 1, 3], without what folds and shadows explain.

    Both are square roots of linear light; folds and shadows change a colour by the fraction ``shading``.
    """
    size = np.maximum(lengths(colour), 1e-3)
    towards = colour / size[:, None]
    away = look - colour
    along, most = component_sums(away * towards), shading * size
    return lengths(away - along.clip(-most, most)[:, None] * towards)


def coat_hem(body: Body, fit: BodyFit, dressed: Dressed, rgb: NDArray[np.uint8], view: View) -> float | None:
    """Return the height in metres of a coat's or a short skirt's hem in the zero pose, or None without one.

    ``rgb`` [H, W, 3] is the front's picture. The outer halves of the legs have the hips' colour down to a hem and
    another one below, and nothing of the room shows between the legs above it. A coat has the chest's colour, too.
    Without a gap between the legs, bare shins are taken for those of shorts.
    """
    mesh, front, mask = dressed.mesh, dressed.views[0], view.mask
    points = SurfacePoints(np.repeat(mesh.faces, len(_PLACES), axis=0), np.tile(_PLACES, (len(mesh.faces), 1)))
    corner, rest, joints = points.corners[:, 0], points.at(mesh.vertices), mesh.skeleton.joints
    hip, knee, ankle = (
        joints[[JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")], 1].mean() for name in _LEGS
    )
    where, pixels = points.at(front.vertices), points.at(front.pixels)
    pixel = np.floor(pixels).astype(np.intp).clip(0, np.array(mask.shape[::-1]) - 1)
    normals = points.directions(vertex_normals(front.vertices, mesh.faces))
    facing = -component_sums(normals * where) / lengths(where)
    shown = mask[pixel[:, 1], pixel[:, 0]] & (facing > _MIN_COSINE)
    look = np.sqrt(to_linear(rgb[pixel[:, 1], pixel[:, 0]] / 255))
    height, trunk = rest[:, 1], trunk_vertices(body)
    half = points.at(trunk_half_width(mesh.vertices, trunk)[:, None])[:, 0]
    trunk, legs = trunk[corner], np.zeros(len(corner), bool)
    outer = trunk & (np.abs(rest[:, 0]) > _OUTER_FRACTION * half)
    for side in ("left", "right"):
        leg = _leg(body, side)[corner]
        line = joints[[JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "knee", "hip")]]
        outer |= leg & (np.abs(rest[:, 0]) > np.abs(np.interp(height, line[:, 1], line[:, 0])))
        legs |= leg
    outer &= shown

    def colour(low: float, high: float, some: NDArray[np.bool_] = outer) -> F64 | None:
        mine = some & (height > low) & (height < high)
        return np.median(look[mine], axis=0)[None] if mine.sum() >= _MIN_SAMPLES else None

    coat, chest = (colour(hip + low, hip + high) for low, high in (_HIPS_M, _CHEST_M))
    trousers = colour(ankle + _SHINS_M[0], knee - _SHINS_M[1])
    skin = colour(0, np.inf, shown & face_vertices(body)[corner])
    if coat is None or chest is None or trousers is None or unlike(trousers, coat)[0] < _SAME_COLOUR_DISTANCE:
        return None
    crotch = float(np.quantile(height[legs], 0.98))
    rows = np.arange(crotch, ankle + _SHINS_M[0], -_HEM_ROW_M)
    found = [np.flatnonzero(outer & ~trunk & (height <= top) & (height > top - _HEM_ROW_M)) for top in rows]
    known = [k for k, mine in enumerate(found) if len(mine) >= _MIN_ROW_SAMPLES]
    shades = np.array([np.median(look[found[k]], axis=0) for k in known]).reshape(-1, 3)
    worn = unlike(shades, coat) < unlike(shades, trousers)
    right = [int(worn[:k].sum() + (~worn[k:]).sum()) for k in range(len(worn) + 1)]
    best = int(np.argmax(right))
    if not 0 < best < len(worn) or right[best] < _MIN_AGREEMENT * len(worn):
        return None
    hem = float(rows[known[best - 1]])
    if crotch - hem < _MIN_COAT_M or hem - rows[-1] < _MIN_TROUSERS_M:
        return None
    row = np.median(pixels[legs & (np.abs(height - hem) < _HEM_ROW_M), 1])
    gaps = leg_gaps(body, fit, view)
    skirt = unlike(chest, coat)[0] > _SAME_COLOUR_DISTANCE
    if not len(gaps):  # the legs touch
        bare = skin is not None and unlike(trousers, skin)[0] < _SKIN_DISTANCE
        return None if skirt or bare else hem
    last, reach = hem_row(gaps, view), _HEM_REACH_FRACTION * view.figure
    lower = -np.inf if last is None else gaps[last, 0] - row
    return hem if -reach < lower < (reach if skirt else np.inf) else None


def hem_row(gaps: F64, view: View) -> int | None:
    """Return the index in ``gaps`` [K, 3], of ``leg_gaps``, at which the cover of the gap ends; None without one.

    Below a skirt or a coat the gap opens at once, between the legs of shorts over many rows.
    """
    rows, _, covered = gaps.T
    bare = covered < 0.5
    last = int(bare.argmax())
    if not bare.any() or last == 0 or covered[:last].mean() < _MIN_COVERED_FRACTION:
        return None
    whole = rows[:last][covered[:last] > _MIN_COVERED_FRACTION].max(initial=rows[0])
    abrupt = rows[last] - whole < _HEM_FRACTION * view.figure
    return last if abrupt and whole - rows[0] > _MIN_SKIRT_FRACTION * view.figure else None


def leg_gaps(body: Body, fit: BodyFit, view: View) -> F64:
    """Return [K, 3]: rows of the front ``view`` with a gap between the bare legs, its width, its covered fraction."""
    front = fit.views[0]
    posed = fully_posed(body, fit.betas, front.root, front.pelvis, front.rotations)
    pixels = projected(posed.points(body.points(np.arange(len(body.vertices)))), view.focal, view.centre)[0]
    crotch = pixels[np.where(trunk_vertices(body) & body.skin, body.vertices[:, 1], np.inf).argmin(), 1]
    legs = []
    for side in ("left", "right"):
        leg = _leg(body, side)
        legs.append(projected_mask(pixels, body.faces[leg[body.faces].all(axis=1)], view.mask.shape))
    gaps = []
    for row in range(max(int(crotch), 0), len(view.mask)):
        ends = [np.flatnonzero(leg[row]) for leg in legs]
        if not len(ends[0]) or not len(ends[1]):
            continue
        low, high = sorted(ends, key=lambda end: float(end.mean()))
        gap = slice(int(low[-1]) + 1, int(high[0]))
        if gap.stop - gap.start > _MIN_GAP_FRACTION * view.figure:
            gaps.append((row, gap.stop - gap.start, view.mask[row, gap].mean()))
    return np.array(gaps, float).reshape(-1, 3)


def dress(body: Body, fit: BodyFit, views: Sequence[View], rgb: NDArray[np.uint8]) -> Dressed:
    """Return the fitted body as a mesh, with a skirt or a coat where the first of ``views``, the front, shows one.

    ``rgb`` [H, W, 3] is the front's picture.
    """
    dressed = with_bare_hands(body, fit, views)
    rest = with_bridged_seat(body, dressed.mesh)
    mesh, changed = replace(dressed.mesh, vertices=rest), (rest != dressed.mesh.vertices).any(axis=1)
    dressed = Dressed(
        mesh, tuple(_moved(mesh, view, old, changed) for view, old in zip(views, dressed.views, strict=True))
    )
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
        if not long or covered.min() < 0.5 or covered.mean() < _MIN_COVERED_FRACTION:
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
