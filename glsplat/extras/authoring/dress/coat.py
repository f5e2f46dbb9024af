"""Find the hem of an open coat, a long jacket or a long shirt, which hangs over trousers as one surface behind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_half_width, trunk_vertices
from glsplat.extras.authoring.dress.fitted_mesh import Dressed
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.meshes import vertex_normals
from glsplat.pictures import to_linear
from glsplat.rotations import component_sums, lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_SAME_COLOUR_DISTANCE, _SKIN_DISTANCE = 0.15, 0.12  # square roots of linear light, shading left out
_ROW_M = 0.02
_MIN_COAT_M, _MIN_TROUSERS_M = 0.06, 0.1  # below the crotch to the hem, and below the hem
_HIPS_M, _CHEST_M = (-0.02, 0.12), (0.2, 0.35)  # above the hip joints
_SHINS_M = 0.08, 0.05  # above the ankles, below the knees
_OUTER_FRACTION = 0.5  # of a trunk's half width: farther outside an open coat covers it
_MIN_COSINE = 0.4  # between a seen surface and the line of sight
_MIN_SAMPLES, _MIN_ROW_SAMPLES = 12, 3
_MIN_AGREEMENT = 0.9  # of the rows that are like the coat above the hem, and like the trousers below it
_MIN_GAP_FRACTION = 0.012  # of the person's height: width of a gap between legs that counts


def unlike(look: F64, colour: F64, shading: float = 0.25) -> F64:
    """Return [M] distances of ``look`` [M, 3] from ``colour`` [M or 1, 3], without what folds and shadows explain.

    Both are square roots of linear light; folds and shadows change a colour by the fraction ``shading``.
    """
    size = np.maximum(lengths(colour), 1e-3)
    towards = colour / size[:, None]
    away = look - colour
    along, most = component_sums(away * towards), shading * size
    return lengths(away - along.clip(-most, most)[:, None] * towards)


def coat_hem(body: Body, dressed: Dressed, rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> float | None:
    """Return the height in metres of a coat's hem in the zero pose, or None if the front's ``rgb`` [H, W, 3] has none.

    The outer halves of the legs have the trunk's colour down to a hem and another one below, and nothing of the room
    shows between the legs above it. Without a gap between the legs, bare shins are taken for those of shorts.
    """
    mesh, front = dressed.mesh, dressed.views[0]
    rest, joints = mesh.vertices, mesh.skeleton.joints
    hip, knee, ankle = (joints[_pair(name), 1].mean() for name in ("hip", "knee", "ankle"))
    pixel = np.floor(front.pixels).astype(np.intp).clip(0, np.array(mask.shape[::-1]) - 1)
    normals = vertex_normals(front.vertices, mesh.faces)
    facing = -component_sums(normals * front.vertices) / lengths(front.vertices)
    shown = mask[pixel[:, 1], pixel[:, 0]] & (facing > _MIN_COSINE)
    look = np.sqrt(to_linear(rgb[pixel[:, 1], pixel[:, 0]] / 255))
    height, trunk = rest[:, 1], trunk_vertices(body)
    legs = {side: np.isin(body.part, _pair("hip", side) + _pair("knee", side)) for side in ("left", "right")}
    outer = trunk & (np.abs(rest[:, 0]) > _OUTER_FRACTION * trunk_half_width(rest, trunk))
    for side, leg in legs.items():
        line = joints[[JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "knee", "hip")]]
        outer |= leg & (np.abs(rest[:, 0]) > np.abs(np.interp(height, line[:, 1], line[:, 0])))
    outer &= shown

    def colour(low: float, high: float, some: NDArray[np.bool_] = outer) -> F64 | None:
        mine = some & (height > low) & (height < high)
        return np.median(look[mine], axis=0)[None] if mine.sum() >= _MIN_SAMPLES else None

    coat, chest = (colour(hip + low, hip + high) for low, high in (_HIPS_M, _CHEST_M))
    trousers, skin = colour(ankle + _SHINS_M[0], knee - _SHINS_M[1]), colour(0, np.inf, shown & face_vertices(body))
    if coat is None or chest is None or trousers is None:
        return None
    if unlike(trousers, coat)[0] < _SAME_COLOUR_DISTANCE or unlike(chest, coat)[0] > _SAME_COLOUR_DISTANCE:
        return None
    crotch = float(np.quantile(height[legs["left"] | legs["right"]], 0.98))
    rows = np.arange(crotch, ankle + _SHINS_M[0], -_ROW_M)
    found = [np.flatnonzero(outer & ~trunk & (height <= top) & (height > top - _ROW_M)) for top in rows]
    known = [k for k, mine in enumerate(found) if len(mine) >= _MIN_ROW_SAMPLES]
    shades = np.array([np.median(look[found[k]], axis=0) for k in known]).reshape(-1, 3)
    worn = unlike(shades, coat) < unlike(shades, trousers)
    right = [int(worn[:k].sum() + (~worn[k:]).sum()) for k in range(len(worn) + 1)]
    best = int(np.argmax(right))
    if not 0 < best < len(worn) or right[best] < _MIN_AGREEMENT * len(worn):
        return None
    hem = float(rows[known[best]])
    if crotch - hem < _MIN_COAT_M or hem - rows[-1] < _MIN_TROUSERS_M:
        return None
    covered = _between(legs, height, front.pixels, mask, rows[rows > hem])
    if not covered.all() or (not len(covered) and skin is not None and unlike(trousers, skin)[0] < _SKIN_DISTANCE):
        return None
    return hem


def _between(
    legs: dict[str, NDArray[np.bool_]], height: F64, pixels: F64, mask: NDArray[np.bool_], rows: F64
) -> NDArray[np.bool_]:
    """Return [K] for each of the ``rows`` with a gap between the legs whether the person covers most of it."""
    seen = np.flatnonzero(mask.any(axis=1))
    least, covered = _MIN_GAP_FRACTION * (seen[-1] - seen[0] + 1), []
    for top in rows:
        near = (height <= top) & (height > top - _ROW_M)
        left, right = (pixels[leg & near] for leg in legs.values())
        if not len(left) or not len(right):
            continue
        first, last = int(right[:, 0].max()) + 1, int(left[:, 0].min())  # the person's left is the picture's right
        row = int(np.median(np.concatenate([left, right])[:, 1]))
        if last - first > least and 0 <= row < len(mask):
            covered.append(mask[row, max(first, 0) : last].mean() > 0.5)
    return np.array(covered, bool)


def _pair(name: str, *sides: str) -> list[int]:
    return [JOINT_NAMES.index(f"{side}_{name}") for side in sides or ("left", "right")]
