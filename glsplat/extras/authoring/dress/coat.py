"""Find hems below which a picture shows the legs apart: of a coat, a long shirt or a skirt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_half_width, trunk_vertices
from glsplat.extras.authoring.dress.fitted_mesh import Dressed
from glsplat.extras.authoring.fit.body_fit import BodyFit
from glsplat.extras.authoring.fit.kinematics import fully_posed, projected
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.fit.outline import projected_mask
from glsplat.extras.authoring.fit.view import View
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_linear
from glsplat.rotations import component_sums, lengths
from glsplat.skinning.smplx import JOINT_NAMES

_SAME_COLOUR_DISTANCE, _SKIN_DISTANCE = 0.15, 0.12  # square roots of linear light, shading left out
_ROW_M = 0.01
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
MIN_COVERED_FRACTION = 0.97
"""Of the gap between the legs, by a skirt or a coat."""


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
    hip, knee, ankle = (joints[_pair(name), 1].mean() for name in ("hip", "knee", "ankle"))
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
        leg = np.isin(body.part[corner], _pair("hip", side) + _pair("knee", side))
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
    rows = np.arange(crotch, ankle + _SHINS_M[0], -_ROW_M)
    found = [np.flatnonzero(outer & ~trunk & (height <= top) & (height > top - _ROW_M)) for top in rows]
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
    row = np.median(pixels[legs & (np.abs(height - hem) < _ROW_M), 1])
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
    if not bare.any() or last == 0 or covered[:last].mean() < MIN_COVERED_FRACTION:
        return None
    whole = rows[:last][covered[:last] > MIN_COVERED_FRACTION].max(initial=rows[0])
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
        leg = np.isin(body.part, _pair("hip", side) + _pair("knee", side))
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


def _pair(name: str, *sides: str) -> list[int]:
    return [JOINT_NAMES.index(f"{side}_{name}") for side in sides or ("left", "right")]
