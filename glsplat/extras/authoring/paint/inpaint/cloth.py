"""Find the colour of a garment or of bare skin all around a limb, to continue it where no picture looks.

Along trunk, legs, arms and neck the visible surface is cut into rows, and each row has one main colour (mean shift,
Comaniciu and Meer 2002, in square roots of linear light). Prints, openings and specks of background are too
small to become it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_half_width, trunk_vertices
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.fit.offsets import face_vertices
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.material import NECKLINE_DISTANCE, Material
from glsplat.extras.authoring.paint.inpaint.pattern import goes_around
from glsplat.extras.authoring.paint.inpaint.rows import (
    MIN_ROW_WEIGHT,
    MIN_TOLERANCE,
    ROW_M,
    SAME_COLOUR_DISTANCE,
    Rows,
    dark_lines,
    in_one_tone,
    main_colour,
    rows_of,
    tolerance_of,
    with_bare_neck,
    with_pattern_above,
    without_mixed_rows,
    without_straps,
    without_unseen_edges,
)
from glsplat.extras.authoring.paint.ramps import ramp
from glsplat.extras.authoring.paint.skin_tone import lab
from glsplat.extras.authoring.paint.view_sample import FittedPicture, ViewSample
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]
Ints = NDArray[np.intp]

_REGIONS = (  # words of the joints' names; along x or y; the region of the other half of the body, if it has one
    (("pelvis", "spine", "collar"), 1, None),
    (("left_hip", "left_knee"), 1, 2),
    (("right_hip", "right_knee"), 1, 1),
    (("left_shoulder", "left_elbow"), 0, 4),
    (("right_shoulder", "right_elbow"), 0, 3),
    (("neck",), 1, None),
    (("left_ankle", "left_foot"), 1, 7),
    (("right_ankle", "right_foot"), 1, 6),
)
TRUNK, LEGS, SLEEVES, NECK = 0, (1, 2), (3, 4), 5
"""Regions of ``Cloth``."""

_BODY, _FEET = (TRUNK, *LEGS), (6, 7)
_CLOTHED, _PAIRS = (0, 1, 2, 3, 4), (LEGS, SLEEVES)  # regions that may have a pattern
_MAX_PATTERN_COLOURS = 2000
_MIN_GARMENT_ROWS = 10
_ROW_REACH_M = 0.0125  # to both sides of a row's middle
_MAX_SAMPLES = 60_000
_MIN_VISIBILITY, _MIN_FACE_VISIBILITY = 0.3, 0.7
_MIRRORED_WEIGHT = 0.2  # of a sample from the other half of the body, but for legs and feet, whose hems are level
_SIDES, _UNSURE_WEIGHT = (0.3, 0.95), 0.25  # of a trunk's half width, where front and back are alike; weight elsewhere
_FLANK = 0.75  # of a trunk's half width: lettering ends there, belts and bare bellies go on
_SKIN_DISTANCE = 0.2  # from the face's colour: nearer colours are bare skin
_MIN_SKIN_CHROMA = 4.5  # CIELAB
_FACE_QUANTILES = 0.5, 0.9  # of a face's brightness
_MIN_STRAP_FRACTION = 0.1  # of a row on the shoulders that is cloth
_MIN_BARE_FRACTION = 0.15  # of a row on the shoulders that is skin beside a strap
_ARMPIT_BELOW_SHOULDER_M, _COLLAR_M = 0.07, 0.01  # below the shoulder joints; above the neck's, behind
_CHEST_M = 0.25  # below the armpits, where the upper garment's colour is taken from
_STRAP_QUANTILE = 0.95  # of its samples' distances from the middle: a strap's edge
_FOREIGN_TOLERANCES = 1.5, 3.0  # from a material's colour: perhaps and surely foreign
_FOREIGN_DISTANCE = 0.15  # at most, between a foreign colour and that of the material it belongs to
_RIM_FRACTION = 0.016  # of the person's height: this near to its outline a part of the body may show other colours


@dataclass(frozen=True, eq=False)
class Cloth:
    """Colours of garments and bare skin; ``cloth_of`` makes one."""

    rest: F64  # [V, 3] the dressed surface in the zero pose
    shares: F64  # [V, R + 1] of each region in a vertex, and of none
    rows: tuple[Rows | None, ...]
    palettes: tuple[cKDTree | None, ...]  # square roots of the colours away from outlines, of patterned regions
    skin: F64 | None  # [3] square root of the face's colour
    armpit: float  # metres of height
    collar: float  # the same, of a collar's edge behind
    lines: F64  # [R] of the trunk's rows, see ``dark_lines``; empty without a trunk

    def region(self, points: SurfacePoints) -> Ints:
        """Return [M] the regions of points; negative: none."""
        return _region_at(points, self.shares)

    @property
    def nape(self) -> F64 | None:
        """[3] unlit linear colour of the neck below the head."""
        rows = self.rows[NECK]
        return None if rows is None else rows.colour[-1] ** 2

    @property
    def patterned(self) -> tuple[float, float] | None:
        """Lowest and highest patterned row of the trunk below the armpits, metres; None without any."""
        rows = self.rows[TRUNK]
        if rows is None:
            return None
        places = rows.places[rows.pattern & (rows.places < self.armpit)]
        return (float(places[0]), float(places[-1])) if len(places) > _MIN_GARMENT_ROWS else None

    def on_sleeves(self, points: SurfacePoints) -> NDArray[np.bool_]:
        """Return [M] which of the points are on arms."""
        return np.asarray(np.isin(self.region(points), SLEEVES))

    def foreign(self, shot: FittedPicture, points: SurfacePoints, linear: F64, shade: F64, material: Material) -> F64:
        """Return [M] from 0 to 1: how surely colours [M, 3] of ``shot`` near an outline belong to something else.

        They are unlike the material there, and more like the background beside the person or the body behind an arm.
        """
        out = np.zeros(len(linear))
        look, mine = np.sqrt(np.maximum(linear / shade[:, None], 0)), self.region(points)
        distance, tolerance = material.distance(look), np.where(material.pattern, MIN_TOLERANCE, material.tolerance)
        for number, palette in enumerate(self.palettes):  # a pattern allows all colours seen away from outlines
            striped = np.flatnonzero(material.pattern & (mine == number))
            if palette is not None and len(striped):
                distance[striped] = palette.query(look[striped])[0] / MIN_TOLERANCE
        pixels = shot.project(points.at(shot.view.vertices))
        some = np.flatnonzero((material.known > 0) & (distance > _FOREIGN_TOLERANCES[0]) & ~np.isin(mine, _FEET))
        near = shot.outline_distance(pixels[some], shot.layers_at(points)[some]) < _RIM_FRACTION
        # a fitted arm may be some centimetres off, over pixels of the trunk's cloth
        near |= np.isin(mine[some], SLEEVES) & shot.over_trunk(pixels[some])
        some = some[near]
        if not len(some):
            return out
        other = lengths(look[some] - np.sqrt(shot.background(pixels[some]) / shade[some, None]))
        for numbers, others in ((SLEEVES, _BODY), (_BODY, SLEEVES)):
            rows = [rows.colour for k in others if (rows := self.rows[k]) is not None]
            which = np.isin(mine[some], numbers)
            if rows and which.any():
                other[which] = np.minimum(other[which], cKDTree(np.concatenate(rows)).query(look[some][which])[0])
        out[some] = ramp(distance[some], *_FOREIGN_TOLERANCES) * (
            other < np.minimum(0.5 * distance[some] * tolerance[some], _FOREIGN_DISTANCE)
        )
        return out

    def at(self, points: SurfacePoints) -> Material:
        """Return the most likely material of the points."""
        count = len(points.corners)
        where, region = points.at(self.rest), self.region(points)
        colour, tolerance, known = np.zeros((count, 3)), np.full(count, MIN_TOLERANCE), np.zeros(count)
        pattern, skin = np.zeros(count, bool), np.full((count, 3), np.nan)
        if self.skin is not None:
            skin[(region == TRUNK) & (where[:, 1] > self.armpit)] = self.skin
        for number, rows in enumerate(self.rows):
            mine = np.flatnonzero(region == number)
            if rows is None or not len(mine):
                continue
            along = np.abs(where[mine, 0]) if rows.axis == 0 else where[mine, 1]
            at = ((along - rows.first) / ROW_M).clip(0, len(rows.colour) - 1)
            low = np.floor(at).astype(np.intp)
            high = np.minimum(low + 1, len(rows.colour) - 1)
            part = at - low
            outside = np.abs(where[mine, 0]) > rows.edge[low]
            mixed = [each[low] + part[:, None] * (each[high] - each[low]) for each in (rows.colour, rows.outer)]
            colour[mine] = np.where(outside[:, None], mixed[1], mixed[0]) ** 2
            tolerance[mine] = rows.tolerance[low]
            pattern[mine] = rows.pattern[low] & ~outside
            known[mine] = 1
        return Material(colour, tolerance, known, pattern, skin)


def cloth_of(body: Body, shot: FittedPicture, points: SurfacePoints, sample: ViewSample, shade: F64) -> Cloth:
    """Return the rows of the body in ``shot``, from its ``sample`` of ``points`` [M] in a light of ``shade`` [M]."""
    rest = shot.mesh.vertices
    neck_joint = shot.mesh.skeleton.joints[JOINT_NAMES.index("neck")]
    shares = _shares(body, rest, neck_joint)
    region = np.where(shares.argmax(axis=1) < len(_REGIONS), shares.argmax(axis=1), -1)
    some = np.flatnonzero(sample.visibility > _MIN_VISIBILITY)
    some = some[:: max(1, len(some) // _MAX_SAMPLES)]
    part = points.take(some)
    where, visibility = part.at(rest), sample.visibility[some]
    look = np.sqrt(np.maximum(sample.linear[some] / shade[some, None], 0))
    mine = _region_at(part, shares)
    share = np.abs(where[:, 0]) / np.maximum(part.at(trunk_half_width(rest, trunk_vertices(body))[:, None])[:, 0], 1e-3)
    beside = (share > _SIDES[0]) & (share < _SIDES[1])
    visibility = visibility * np.where((mine == TRUNK) & ~beside, _UNSURE_WEIGHT, 1.0)
    pixels = shot.project(part.at(shot.view.vertices))
    deep = shot.outline_distance(pixels, shot.layers_at(part)) >= _RIM_FRACTION
    visibility = visibility * np.where(deep, 1.0, _UNSURE_WEIGHT)
    face = (face_vertices(body)[part.corners]).all(axis=1) & (sample.visibility[some] > _MIN_FACE_VISIBILITY)
    skin = _face_colour(look[face]) if face.sum() > 2 * MIN_ROW_WEIGHT else None
    if skin is not None and np.hypot(*lab(skin[None] ** 2)[0, 1:]) < _MIN_SKIN_CHROMA:
        skin = None  # a grey picture: cloth may have any skin's colour
    shoulder = shot.mesh.skeleton.joints[[JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")], 1]
    armpit = float(shoulder.mean()) - _ARMPIT_BELOW_SHOULDER_M

    def row_of(number: int) -> Rows | None:
        _, axis, other = _REGIONS[number]
        own = region == number
        along = np.abs(rest[own, 0]) if axis == 0 else rest[own, 1]
        mirrored = _MIRRORED_WEIGHT if number in SLEEVES else 1.0
        weight = visibility * ((mine == number) + mirrored * (mine == (-1 if other is None else other)))
        taken = np.flatnonzero(weight > 0)
        at = np.abs(where[taken, 0]) if axis == 0 else where[taken, 1]
        ends = float(along.min()), float(along.max())
        these = rows_of(axis, ends, at, look[taken], weight[taken], _ROW_REACH_M, number in LEGS)
        if these is None:
            return None
        x, y = where[taken, 0], where[taken, 1]
        across = y if axis == 0 else x if other is None else np.abs(x)
        if number in _CLOTHED:
            below = (number != TRUNK) | (at < armpit)  # above the armpits cloth and skin mix
            row = ((at - these.first) / ROW_M).round().astype(np.intp).clip(0, len(these.colour) - 1)[below]
            pattern = goes_around(these.colour, row, across[below], look[taken][below], weight[taken][below])
            if number != TRUNK and skin is not None:  # bare knees and elbows are no pattern
                least = NECKLINE_DISTANCE if number in SLEEVES else _SKIN_DISTANCE
                pattern &= np.linalg.norm(these.colour - skin, axis=1) > least
            these = replace(these, pattern=pattern)
        if number in _FEET:
            return without_straps(without_mixed_rows(these), at, look[taken], weight[taken])
        if number != TRUNK:
            plain = without_mixed_rows(these)
            return without_unseen_edges(plain, at, across, look[taken]) if number in LEGS else plain
        sides = rows_of(axis, ends, at, look[taken], weight[taken] * (share[taken] > _FLANK), _ROW_REACH_M)
        return without_mixed_rows(these, None if sides is None else sides.colour)

    rows = map_threads(row_of, range(len(_REGIONS)))
    for left, right in _PAIRS:  # sleeves, and trouser legs, are of one cloth
        one, other_one = rows[left], rows[right]
        if one is not None and other_one is not None:
            count = min(len(one.pattern), len(other_one.pattern))
            both = one.pattern[:count] & other_one.pattern[:count]
            rows[left] = replace(one, pattern=np.pad(both, (0, len(one.pattern) - count)))
            rows[right] = replace(other_one, pattern=np.pad(both, (0, len(other_one.pattern) - count)))
    trunk, neck, here = rows[TRUNK], rows[NECK], np.flatnonzero(mine == TRUNK)
    if neck is not None and skin is not None:
        rows[NECK] = with_bare_neck(neck, skin)
    if trunk is not None and skin is not None:
        trunk = _cover_shoulders(trunk, where[here], look[here], visibility[here], skin, armpit)
    rows[TRUNK] = None if trunk is None else with_pattern_above(trunk, armpit, _CHEST_M)
    lines = np.zeros(0) if trunk is None else dark_lines(trunk, where[here, 1], where[here, 0], look[here])
    for number in SLEEVES:
        sleeve, trunk = rows[number], rows[TRUNK]
        if sleeve is not None and trunk is not None and skin is not None:
            rows[number] = _pattern_sleeve(sleeve, trunk, skin, armpit)
    for numbers in (_BODY, SLEEVES, (NECK,)):
        seen = {number: each for number in numbers if (each := rows[number]) is not None}
        for number, each in zip(seen, in_one_tone(list(seen.values())), strict=True):
            rows[number] = each
    palettes = [_palette(row, look[deep & (mine == number)]) for number, row in enumerate(rows)]
    return Cloth(rest, shares, tuple(rows), tuple(palettes), skin, armpit, float(neck_joint[1]) + _COLLAR_M, lines)


def _palette(rows: Rows | None, look: F64) -> cKDTree | None:
    """Return the colours [K, 3] of a patterned region; None without a pattern."""
    if rows is None or not rows.pattern.any() or len(look) < MIN_ROW_WEIGHT:
        return None
    return cKDTree(look[:: max(1, len(look) // _MAX_PATTERN_COLOURS)])


def _shares(body: Body, rest: F64, neck: F64) -> F64:
    """Return [V, R + 1] the largest skinning weight of each region's joints, and of those without a region.

    Legs above the crotch are trunk: a shirt's hem is a row there. Behind the joint ``neck`` [3] collars are level.
    ``rest`` [V, 3] is the surface in the zero pose.
    """
    of_joint = np.full(len(JOINT_NAMES), len(_REGIONS), np.intp)
    for number, (words, _, _) in enumerate(_REGIONS):
        of_joint[[index for index, name in enumerate(JOINT_NAMES) if any(word in name for word in words)]] = number
    shares = np.zeros((len(body.vertices), len(_REGIONS) + 1))
    np.maximum.at(shares, (np.arange(len(shares))[:, None], of_joint[body.skin_joints]), body.skin_weights)
    crotch = rest[shares.argmax(axis=1) == TRUNK, 1].min()
    legs, above = [number for number in _BODY if number != TRUNK], ramp(rest[:, 1], crotch, crotch + ROW_M)[:, None]
    shares[:, [TRUNK]] += above * shares[:, legs].sum(axis=1, keepdims=True)
    shares[:, legs] *= 1 - above
    nape = ramp(rest[:, 1] - neck[1], _COLLAR_M + ROW_M, _COLLAR_M) * (rest[:, 2] < neck[2])
    shares[:, TRUNK] += nape * shares[:, NECK]
    shares[:, NECK] *= 1 - nape
    return np.where(body.skin[:, None], shares, np.eye(len(_REGIONS) + 1)[-1])


def _region_at(points: SurfacePoints, shares: F64) -> Ints:
    """Return [M] the regions of points, negative for none; they meet along smooth lines, not along triangles."""
    of_corner = shares.argmax(axis=1)[points.corners]
    region = of_corner[:, 0].copy()
    mixed = np.flatnonzero((of_corner != region[:, None]).any(axis=1))
    region[mixed] = points.take(mixed).at(shares).argmax(axis=1)
    return np.where(region < len(_REGIONS), region, -1)


def _pattern_sleeve(rows: Rows, trunk: Rows, skin: F64, armpit: float) -> Rows:
    """Return an arm's rows with the shirt's pattern down to where the arm is bare."""
    places = trunk.places
    chest = trunk.pattern[(places > armpit - _CHEST_M) & (places < armpit)]
    if not len(chest) or chest.mean() < 0.5:
        return rows
    bare = np.linalg.norm(rows.colour - skin, axis=1) < SAME_COLOUR_DISTANCE
    return replace(rows, pattern=rows.pattern | ~np.logical_or.accumulate(bare))


def _face_colour(look: F64) -> F64:
    """Return [3] the colour of the brighter half of a face's samples [K, 3]: without beard, shade and highlights."""
    light = look.sum(axis=1)
    low, high = np.quantile(light, _FACE_QUANTILES)
    return np.asarray(np.median(look[(light >= low) & (light <= high)], axis=0))


def _cover_shoulders(rows: Rows, where: F64, look: F64, visibility: F64, skin: F64, armpit: float) -> Rows:
    """Return the rows with cloth above the armpits: the back is covered as the front's shoulders are."""
    places = rows.places
    below = (places > armpit - _CHEST_M) & (places < armpit)
    if not below.any():
        return rows
    upper = np.median(rows.colour[below], axis=0)
    from_skin = np.linalg.norm(look - skin, axis=1)
    colour, outer, edge = rows.colour.copy(), rows.colour.copy(), np.full(len(places), np.nan)
    tolerance, pattern, last = rows.tolerance.copy(), rows.pattern.copy(), -1
    for row in np.flatnonzero(places >= armpit):
        beneath = colour[row - 1] if row else upper  # shirts may change colour at the shoulders
        worn = [one for one in (upper, beneath) if np.linalg.norm(one - skin) > SAME_COLOUR_DISTANCE]
        if not worn:
            continue
        distance = np.min([np.linalg.norm(look - one, axis=1) for one in worn], axis=0)
        mine = np.abs(where[:, 1] - places[row]) < _ROW_REACH_M
        strap = mine & (distance < np.minimum(from_skin / 2, 2 * SAME_COLOUR_DISTANCE))
        if visibility[strap].sum() < max(_MIN_STRAP_FRACTION * visibility[mine].sum(), MIN_ROW_WEIGHT / 3):
            continue
        last = int(row)
        colour[row], spread = main_colour(look[strap], visibility[strap])
        tolerance[row] = tolerance_of(spread)
        edge[row] = np.quantile(np.abs(where[strap, 0]), _STRAP_QUANTILE)
        beyond = mine & (np.abs(where[:, 0]) > edge[row])
        bare = beyond & (from_skin < np.minimum(distance, 2 * SAME_COLOUR_DISTANCE))
        if rows.pattern[row] or rows.pattern[below].mean() > 0.5:
            bare &= from_skin < NECKLINE_DISTANCE  # dark patterns may be close to skin
        if visibility[bare].sum() > max(_MIN_BARE_FRACTION * visibility[mine].sum(), visibility[beyond].sum() / 2):
            outer[row] = main_colour(look[bare], visibility[bare])[0]
        elif np.isfinite(edge[:row]).any():
            outer[row] = outer[row - 1]
        else:
            edge[row] = np.inf
            pattern[row] = pattern[row - 1]
    known = np.flatnonzero(np.isfinite(edge))
    if len(known):
        between = np.isnan(edge) & (places >= armpit) & (np.arange(len(places)) < known[-1])
        edge[between] = np.interp(np.flatnonzero(between), known, edge[known])
        for k in range(3):
            colour[between, k] = np.interp(np.flatnonzero(between), known, colour[known, k])
    elif last >= 0:  # no strap: the shoulders' cloth goes up to the neck
        colour[last:], outer[last:], tolerance[last:] = colour[last], colour[last], tolerance[last]
        pattern[last:] = pattern[last]
    edge[np.isnan(edge)] = np.inf
    return replace(rows, colour=colour, outer=outer, tolerance=tolerance, edge=edge, pattern=pattern)
