"""Which colour a garment or bare skin has all around a limb, so that what no picture shows is the same piece of cloth.

Along trunk, legs, arms and neck the seen surface is cut into rows, and each row has one colour that most of it shows
(mean shift, Comaniciu and Meer 2002, in square roots of linear light): prints, openings, hands and specks of the room
are too few to be it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import HANDS, half_width, trunk_of
from glsplat.extras.authoring.compute.threads import abreast
from glsplat.extras.authoring.fit.offsets import face_of
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.inpaint.material import BARE, Ground
from glsplat.extras.authoring.paint.inpaint.pattern import goes_around
from glsplat.extras.authoring.paint.inpaint.rows import ALIKE, FEWEST, STEP, TOLERANCE, Rows, most_of, rows_of, steady
from glsplat.extras.authoring.paint.view_sample import FittedPicture, Sight
from glsplat.rotations import lengths
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Cloth", "cloth_of"]

F64 = NDArray[np.float64]
Ints = NDArray[np.intp]

_REGIONS = (  # words of the joints' names; along x or y; the region of the other half of the body, if it has one
    (("pelvis", "spine", "collar"), 1, None),
    (("left_hip", "left_knee"), 1, 2),
    (("right_hip", "right_knee"), 1, 1),
    (("left_shoulder", "left_elbow"), 0, 4),
    (("right_shoulder", "right_elbow"), 0, 3),
    (("neck",), 1, None),
    (tuple(f"left_{word}" for word in HANDS), 0, 7),
    (tuple(f"right_{word}" for word in HANDS), 0, 6),
    (("left_ankle", "left_foot"), 1, 9),
    (("right_ankle", "right_foot"), 1, 8),
)
_TRUNK, _NECK, _BODY, _ARMS, _HANDS, _FEET = 0, 5, (0, 1, 2), (3, 4, 6, 7), (6, 7), (8, 9)
_SLEEVES = 3, 4
_CLOTHED, _PAIRS = (0, 1, 2, 3, 4), ((1, 2), _SLEEVES)  # regions that patterns are looked for in
_COLOURS = 2000  # of a pattern
_GARMENT = 10  # rows that are a piece of cloth
_REACH = 0.0125  # metres to both sides whose samples a row has
_MOST = 60_000  # samples that are looked at
_SURE = 0.3  # trust of a sample
_LENT = 0.2  # what a sample of the other half of the body says
_SIDES, _MIDDLE = (0.3, 0.95), 0.25  # halves of a trunk's width where it looks as it does behind; weight of the rest
_LIKE_SKIN = 0.2  # from the face: a hand is as bare
_LIGHT = 0.5, 0.9  # quantiles of a face's brightness
_COVERED = 0.1  # share of a row on the shoulders that is cloth where there is a strap
_ARMPIT = 0.07  # metres below the shoulder joints
_BELOW = 0.25  # metres below the armpits that the upper garment's colour is taken from
_STRANGE = 1.5, 3.0  # tolerances: from the first on a colour is doubted, from the second on it is not believed
_LIKE_OTHER = 0.15  # how near a colour lies to the thing it is of
_SHALLOW = 0.016  # of the person's height: so near to its outline a part of the body may show something else


@dataclass(frozen=True, eq=False)
class Cloth:
    """The colours of garments and bare skin; ``cloth_of`` makes one."""

    rest: F64  # [V, 3] the dressed surface in the zero pose
    region: Ints  # [V], below zero none
    rows: tuple[Rows | None, ...]
    palettes: tuple[cKDTree | None, ...]  # of regions with a pattern, square roots of the colours deep inside
    skin: F64 | None  # [3] square roots of the face's colour
    armpit: float  # metres of height

    @property
    def nape(self) -> F64 | None:
        """[3] linear colour without light of the neck below the head."""
        rows = self.rows[_NECK]
        return None if rows is None else rows.colour[-1] ** 2

    @property
    def patterned(self) -> tuple[float, float] | None:
        """Lowest and highest of the trunk's rows below the armpits that have a pattern, metres; None without any."""
        rows = self.rows[_TRUNK]
        if rows is None:
            return None
        places = rows.places[rows.pattern & (rows.places < self.armpit)]
        return (float(places[0]), float(places[-1])) if len(places) > _GARMENT else None

    def sleeves(self, points: SurfacePoints) -> NDArray[np.bool_]:
        """[M] which of the points are on arms."""
        return np.asarray(np.isin(self.region[points.corners[:, 0]], _SLEEVES))

    def strange(self, shot: FittedPicture, points: SurfacePoints, linear: F64, shade: F64, ground: Ground) -> F64:
        """[M] from 0 to 1: how surely colours [M, 3] that ``shot`` has near an outline are another thing's.

        They are unlike the cloth that is there, and more like the room beside the person or what an arm is before.
        """
        out = np.zeros(len(linear))
        look, mine = np.sqrt(np.maximum(linear / shade[:, None], 0)), self.region[points.corners[:, 0]]
        away, tolerance = ground.away(look), np.where(ground.pattern, TOLERANCE[0], ground.tolerance)
        for number, palette in enumerate(self.palettes):  # of a pattern all colours that are seen farther inside
            striped = np.flatnonzero(ground.pattern & (mine == number))
            if palette is not None and len(striped):
                away[striped] = palette.query(look[striped])[0] / TOLERANCE[0]
        pixels = shot.project(points.at(shot.view.vertices))
        some = np.flatnonzero((ground.there > 0) & (away > _STRANGE[0]) & ~np.isin(mine, _FEET))
        near = shot.shallow(pixels[some], shot.layers_at(points)[some]) < _SHALLOW
        # a fit has an arm before the trunk some centimetres aside, where its pixels may be the trunk's cloth
        near |= np.isin(mine[some], _ARMS) & shot.over_trunk(pixels[some])
        some = some[near | np.isin(mine[some], _HANDS)]
        if not len(some):
            return out
        other = lengths(look[some] - np.sqrt(shot.room(pixels[some]) / shade[some, None]))
        for numbers, others in ((_ARMS, _BODY), (_BODY, _ARMS)):
            rows = [rows.colour for k in others if (rows := self.rows[k]) is not None]
            which = np.isin(mine[some], numbers)
            if rows and which.any():
                other[which] = np.minimum(other[which], cKDTree(np.concatenate(rows)).query(look[some][which])[0])
        sure = ((away[some] - _STRANGE[0]) / (_STRANGE[1] - _STRANGE[0])).clip(0, 1)
        out[some] = sure * (other < np.minimum(0.5 * away[some] * tolerance[some], _LIKE_OTHER))
        return out

    def at(self, points: SurfacePoints) -> Ground:
        """What the points are most likely to be."""
        count = len(points.corners)
        where, region = points.at(self.rest), self.region[points.corners[:, 0]]
        colour, tolerance, there = np.zeros((count, 3)), np.full(count, TOLERANCE[0]), np.zeros(count)
        pattern, skin = np.zeros(count, bool), np.full((count, 3), np.nan)
        if self.skin is not None:
            skin[(region == _TRUNK) & (where[:, 1] > self.armpit)] = self.skin
        for number, rows in enumerate(self.rows):
            mine = np.flatnonzero(region == number)
            if rows is None or not len(mine):
                continue
            along = (
                np.abs(where[mine, rows.axis]) - rows.first if rows.axis == 0 else where[mine, 1] - rows.first
            ) / STEP
            at = along.clip(0, len(rows.colour) - 1)
            low = np.floor(at).astype(np.intp)
            high = np.minimum(low + 1, len(rows.colour) - 1)
            part = at - low
            outside = np.abs(where[mine, 0]) > rows.edge[low]
            mixed = [each[low] + part[:, None] * (each[high] - each[low]) for each in (rows.colour, rows.outer)]
            colour[mine] = np.where(outside[:, None], mixed[1], mixed[0]) ** 2
            tolerance[mine] = rows.tolerance[low]
            pattern[mine] = rows.pattern[low] & ~outside
            there[mine] = 1
        return Ground(colour, tolerance, there, pattern, skin, np.isin(region, _HANDS))


def cloth_of(body: Body, shot: FittedPicture, points: SurfacePoints, sight: Sight, shade: F64) -> Cloth:
    """The rows of the body in ``shot``, from what it shows of ``points`` [M] in a light of ``shade`` [M]."""
    rest = shot.mesh.vertices
    region = _regions(body)
    some = np.flatnonzero(sight.trust > _SURE)
    some = some[:: max(1, len(some) // _MOST)]
    part = points.take(some)
    where, trust = part.at(rest), sight.trust[some]
    look = np.sqrt(np.maximum(sight.linear[some] / shade[some, None], 0))
    mine = region[part.corners[:, 0]]
    share = np.abs(where[:, 0]) / np.maximum(part.at(half_width(rest, trunk_of(body))[:, None])[:, 0], 1e-3)
    beside = (share > _SIDES[0]) & (share < _SIDES[1])
    trust = trust * np.where((mine == _TRUNK) & ~beside, _MIDDLE, 1.0)
    pixels = shot.project(part.at(shot.view.vertices))
    deep = shot.shallow(pixels, shot.layers_at(part)) >= _SHALLOW
    trust = trust * np.where(deep, 1.0, _MIDDLE)
    face = (face_of(body)[part.corners]).all(axis=1) & (sight.trust[some] > 0.7)
    skin = _bright(look[face]) if face.sum() > 2 * FEWEST else None
    shoulder = shot.mesh.skeleton.joints[[JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")], 1]
    armpit = float(shoulder.mean()) - _ARMPIT

    def row_of(number: int) -> Rows | None:
        _, axis, other = _REGIONS[number]
        own = region == number
        along = np.abs(rest[own, 0]) if axis == 0 else rest[own, 1]
        weight = trust * ((mine == number) + _LENT * (mine == (-1 if other is None else other)))
        taken = np.flatnonzero(weight > 0)
        at = np.abs(where[taken, 0]) if axis == 0 else where[taken, 1]
        reach = np.inf if number in _HANDS else _REACH
        if number in _HANDS and skin is not None:
            bare = np.linalg.norm(look[taken] - skin, axis=1) < _LIKE_SKIN
            if weight[taken][bare].sum() > max(_COVERED * weight[taken].sum(), FEWEST):
                at, taken = at[bare], taken[bare]  # and cuffs are not the hand
        these = rows_of(axis, (float(along.min()), float(along.max())), at, look[taken], weight[taken], reach)
        these = None if these is None else steady(these)
        if these is not None and number in _CLOTHED:
            below = (number != _TRUNK) | (at < armpit)  # what is above is cloth and skin
            row = ((at - these.first) / STEP).round().astype(np.intp).clip(0, len(these.colour) - 1)[below]
            across = (
                where[taken, 1] if axis == 0 else where[taken, 0] * (1 if other is None else np.sign(where[taken, 0]))
            )
            pattern = goes_around(these.colour, row, across[below], look[taken][below], weight[taken][below])
            if number != _TRUNK and skin is not None:  # knees and elbows are no pattern
                pattern &= np.linalg.norm(these.colour - skin, axis=1) > (BARE if number in _SLEEVES else _LIKE_SKIN)
            these = replace(these, pattern=pattern)
        return these

    rows = abreast(row_of, range(len(_REGIONS)))
    for left, right in _PAIRS:  # both sleeves, or both legs of trousers, are of the same cloth
        one, other_one = rows[left], rows[right]
        if one is not None and other_one is not None:
            count = min(len(one.pattern), len(other_one.pattern))
            both = one.pattern[:count] & other_one.pattern[:count]
            rows[left] = replace(one, pattern=np.pad(both, (0, len(one.pattern) - count)))
            rows[right] = replace(other_one, pattern=np.pad(both, (0, len(other_one.pattern) - count)))
    trunk, neck, here = rows[_TRUNK], rows[_NECK], np.flatnonzero(mine == _TRUNK)
    if neck is not None and skin is not None:
        rows[_NECK] = _shaved(neck, skin)
    if trunk is not None and skin is not None:
        rows[_TRUNK] = _covered(trunk, where[here], look[here], trust[here], skin, armpit)
    for number in _SLEEVES:
        sleeve, trunk = rows[number], rows[_TRUNK]
        if sleeve is not None and trunk is not None and skin is not None:
            rows[number] = _sleeved(sleeve, trunk, skin, armpit)
    palettes = [_palette(row, look[deep & (mine == number)]) for number, row in enumerate(rows)]
    return Cloth(rest, region, tuple(rows), tuple(palettes), skin, armpit)


def _palette(rows: Rows | None, look: F64) -> cKDTree | None:
    """The colours [K, 3] of a region, where that has a pattern."""
    if rows is None or not rows.pattern.any() or len(look) < FEWEST:
        return None
    return cKDTree(look[:: max(1, len(look) // _COLOURS)])


def _regions(body: Body) -> Ints:
    """[V] the number of each vertex's region, below zero none."""
    of_joint = np.full(len(JOINT_NAMES), -1, np.intp)
    for number, (words, _, _) in enumerate(_REGIONS):
        of_joint[[index for index, name in enumerate(JOINT_NAMES) if any(word in name for word in words)]] = number
    return np.where(body.skin, of_joint[body.part], -1)


def _sleeved(rows: Rows, trunk: Rows, skin: F64, armpit: float) -> Rows:
    """An arm's, with the pattern of the shirt as far down as it is not bare."""
    middle = trunk.places
    chest = trunk.pattern[(middle > armpit - _BELOW) & (middle < armpit)]
    if not len(chest) or chest.mean() < 0.5:
        return rows
    bare = np.linalg.norm(rows.colour - skin, axis=1) < ALIKE
    return replace(rows, pattern=rows.pattern | ~np.logical_or.accumulate(bare))


def _shaved(rows: Rows, skin: F64) -> Rows:
    """A neck's, whose skin goes on up to the hair behind where a beard or the chin's shadow is before."""
    colour, tolerance = rows.colour.copy(), rows.tolerance.copy()
    first = int(np.linalg.norm(colour - skin, axis=1).argmin())
    colour[first:], tolerance[first:] = colour[first], tolerance[first]
    return replace(rows, colour=colour, outer=colour, tolerance=tolerance)


def _bright(look: F64) -> F64:
    """[3] of a face's samples [K, 3] the colour of its brighter half, which is neither beard nor shade nor glint."""
    light = look.sum(axis=1)
    low, high = np.quantile(light, _LIGHT)
    return np.asarray(np.median(look[(light >= low) & (light <= high)], axis=0))


def _covered(rows: Rows, where: F64, look: F64, trust: F64, skin: F64, armpit: float) -> Rows:
    """With cloth above the armpits: a back is covered as far up and aside as the front's straps or shoulders are."""
    middle = rows.places
    below = (middle > armpit - _BELOW) & (middle < armpit)
    if not below.any():
        return rows
    upper = np.median(rows.colour[below], axis=0)
    from_skin = np.linalg.norm(look - skin, axis=1)
    colour, outer, edge = rows.colour.copy(), rows.colour.copy(), np.full(len(middle), np.nan)
    tolerance, pattern, last = rows.tolerance.copy(), rows.pattern.copy(), -1
    for row in np.flatnonzero(middle >= armpit):
        beneath = colour[row - 1] if row else upper  # a shirt may have another colour about the shoulders
        worn = [one for one in (upper, beneath) if np.linalg.norm(one - skin) > ALIKE]
        if not worn:
            continue
        away = np.min([np.linalg.norm(look - one, axis=1) for one in worn], axis=0)
        cloth, naked = away < np.minimum(from_skin / 2, 2 * ALIKE), from_skin < np.minimum(away, 2 * ALIKE)
        mine = np.abs(where[:, 1] - middle[row]) < _REACH
        strap = mine & cloth
        if trust[strap].sum() < max(_COVERED * trust[mine].sum(), FEWEST / 3):
            continue
        last = int(row)
        colour[row], spread = most_of(look[strap], trust[strap])
        tolerance[row] = np.clip(TOLERANCE[1] * spread, TOLERANCE[0], TOLERANCE[2])
        edge[row] = np.quantile(np.abs(where[strap, 0]), 0.95)
        beyond = mine & (np.abs(where[:, 0]) > edge[row])
        bare = beyond & naked
        if rows.pattern[row]:
            bare &= from_skin < BARE  # a pattern may be nearly as dark as skin
        if trust[bare].sum() > max(FEWEST / 3, trust[beyond].sum() / 2):
            outer[row] = most_of(look[bare], trust[bare])[0]
        elif np.isfinite(edge[:row]).any():
            outer[row] = outer[row - 1]
        else:
            edge[row] = np.inf
            pattern[row] = pattern[row - 1]
    known = np.flatnonzero(np.isfinite(edge))
    if len(known):
        between = np.isnan(edge) & (middle >= armpit) & (np.arange(len(middle)) < known[-1])
        edge[between] = np.interp(np.flatnonzero(between), known, edge[known])
        for k in range(3):
            colour[between, k] = np.interp(np.flatnonzero(between), known, colour[known, k])
    elif last >= 0:  # no strap: what covers the shoulders goes on to the neck
        colour[last:], outer[last:], tolerance[last:] = colour[last], colour[last], tolerance[last]
        pattern[last:] = pattern[last]
    edge[np.isnan(edge)] = np.inf
    return replace(rows, colour=colour, outer=outer, tolerance=tolerance, edge=edge, pattern=pattern)
