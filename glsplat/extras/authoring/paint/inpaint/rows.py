"""Cut cloth along a limb into rows, and find the main colour of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.dress.skirt import unlike
from glsplat.rotations import component_sums, lengths

F64 = NDArray[np.float64]

ROW_M = 0.01
"""Length of a row along the limb."""

MIN_ROW_WEIGHT = 6.0
"""Summed visibility of a row's samples, at least."""

MIN_TOLERANCE, _TOLERANCE_PER_SPREAD, _MAX_TOLERANCE = 0.06, 2.0, 0.14
"""Distance of a row's colours from its main one, in square roots of linear light; in proportion to their spread."""

SAME_COLOUR_DISTANCE = 0.15
"""Colours nearer to each other, in square roots of linear light, count as one."""

_MIN_ROW_FRACTION = 0.1  # of the median row's weight; a lighter row is the edge of an arm before the trunk
_THIN_FACTOR = 0.5  # of that fraction, for legs: ankles are half as wide
_GAP_END_ROWS = 15  # beside hidden rows: their median colour is continued
_KERNEL_SIGMA, _SHIFT_STEPS = 0.08, 6  # of mean shift
_MIXED_TOLERANCE, _MIXED_ROWS = 0.139, 12  # of a row of several colours; between the rows it is compared with
_MIXED_DISTANCE = 0.1  # from these, at least, and between them, at most
_EDGE_ROWS, _STRIP_M = 4, 0.03  # compared on each side of an edge; strips along the limb in which it has to be seen
_MIN_STRIP_SAMPLES, _MIN_EDGE_SHARE = 6, 0.5  # of the rows' difference, for the median strip
_SOFT_ROWS = 9  # over which the colours of rows without an edge in the picture turn
_NECK_SHADING = 0.4  # fraction by which a bare neck may be brighter or darker than the face
_CHIN_SHADOW, _SAME_HUE_DISTANCE = 0.65, 0.01  # fraction by which a throat may be darker, of the face's very hue
_MIN_SANDAL_SKIN_FRACTION, _SOLE_M = 0.25, 0.025  # of a row of a foot that is skin; height of the sole
_TONE_M, _TONE_DISTANCE = 0.12, 0.05  # between rows whose colours become one, and between these but for their light
_BESIDE_LINE_ROWS = (-3, -2, 2, 3)  # with which a row is compared to find a line
_MIN_LINE_SAMPLES, _MIN_LINE_STRIPS = 4, 5  # of a strip in each row, and of a row


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The R rows of one region."""

    axis: int
    first: float  # metres, of the first row along the axis
    colour: F64  # [R, 3] square roots of linear light
    tolerance: F64  # [R]
    outer: F64  # [R, 3] square roots of linear light, of cloth farther from the middle than ``edge``
    edge: F64  # [R] metres
    pattern: NDArray[np.bool_]  # [R]

    @property
    def places(self) -> F64:
        """[R] metres along the axis."""
        return np.asarray(self.first + ROW_M * np.arange(len(self.colour)))

    def index(self, along: F64) -> NDArray[np.intp]:
        """Return [M] the rows at places ``along`` [M] the axis, metres."""
        return np.round((along - self.first) / ROW_M).astype(np.intp).clip(0, len(self.colour) - 1)


def rows_of(
    axis: int, ends: tuple[float, float], at: F64, look: F64, weight: F64, reach: float, thin: bool = False
) -> Rows | None:
    """Return the rows between ``ends`` (metres) from samples ``at`` [K] metres; None if none has enough of them.

    A row takes samples within ``reach`` metres. Rows with few samples take the colours around them, but a limb
    that gets ``thin``, as a leg does, may have half as many.
    """
    count = max(2, int(np.ceil((ends[1] - ends[0]) / ROW_M)) + 1)
    order = np.argsort(at, kind="stable")
    at, look, weight = at[order], look[order], weight[order]
    middles = ends[0] + np.arange(count) * ROW_M
    first, last = (np.searchsorted(at, middles + side * reach) for side in (-1, 1))
    total = np.append(0.0, np.cumsum(weight))
    seen = total[last] - total[first]
    enough = seen >= MIN_ROW_WEIGHT
    if not enough.any():
        return None
    fraction = _MIN_ROW_FRACTION * (_THIN_FACTOR if thin else 1.0)
    known = enough & (seen >= fraction * np.median(seen[enough]))
    colour, tolerance = np.zeros((count, 3)), np.zeros(count)
    for row in np.flatnonzero(known):
        some = slice(first[row], last[row])
        colour[row], spread = main_colour(look[some], weight[some])
        tolerance[row] = tolerance_of(spread)
        if not np.isfinite(reach):
            colour[:], tolerance[:] = colour[row], tolerance[row]
            break
    rows, seen_rows = np.arange(count), np.flatnonzero(known)
    around = colour.copy()  # a median at the ends of a gap, since a print may end there
    for gap in np.flatnonzero(np.diff(seen_rows) > 1):
        around[seen_rows[gap]] = np.median(colour[seen_rows[max(0, gap + 1 - _GAP_END_ROWS) : gap + 1]], axis=0)
        around[seen_rows[gap + 1]] = np.median(colour[seen_rows[gap + 1 : gap + 1 + _GAP_END_ROWS]], axis=0)
    filled = np.stack([np.interp(rows, seen_rows, around[seen_rows, k]) for k in range(3)], axis=1)
    colour = np.where(known[:, None], colour, filled)
    tolerance = np.interp(rows, seen_rows, tolerance[known])
    return Rows(axis, ends[0], colour, tolerance, colour, np.full(count, np.inf), np.zeros(count, bool))


def tolerance_of(spread: float) -> float:
    """Return the distance within which colours of a row with this ``spread`` count as its cloth."""
    return float(np.clip(_TOLERANCE_PER_SPREAD * spread, MIN_TOLERANCE, _MAX_TOLERANCE))


def main_colour(look: F64, weight: F64) -> tuple[F64, float]:
    """Return [3] the colour that most samples have (mean shift), and the median distance of the samples to it."""
    mode = np.median(look[weight >= np.median(weight)], axis=0)
    for _ in range(_SHIFT_STEPS):
        near = weight * np.exp(-0.5 * component_sums((look - mode) ** 2) / _KERNEL_SIGMA**2)
        mode = (near[:, None] * look).sum(axis=0) / max(float(near.sum()), 1e-12)
    away = lengths(look - mode)
    order = np.argsort(away, kind="stable")
    total = np.cumsum(weight[order])
    return mode, float(away[order[np.searchsorted(total, 0.5 * total[-1])]])


def without_mixed_rows(rows: Rows, flanks: F64 | None = None) -> Rows:
    """Return the rows without those of several colours between two that agree: an aslant hem, or lettering.

    Rows of a pattern stay, and those that have their colour at their ends, too, ``flanks`` [R, 3]: a bare belly. If
    one such row is left alone, it is lettering, too: belts have more rows. Hems of legs may have one, and no flanks.
    """
    colour, odd = rows.colour.copy(), (rows.tolerance > _MIXED_TOLERANCE) & ~rows.pattern
    far = np.linalg.norm(colour[:, None] - colour, axis=2) > _MIXED_DISTANCE
    for row in np.flatnonzero(odd).tolist():
        first, last = max(row - _MIXED_ROWS, 0), row + _MIXED_ROWS
        low, high = first + np.flatnonzero(far[row, first:row]), row + 1 + np.flatnonzero(far[row, row + 1 : last])
        agree = np.argwhere(~far[np.ix_(low, high)] & (high - low[:, None] <= _MIXED_ROWS))
        if len(agree):
            before, after = low[agree[:, 0]], high[agree[:, 1]]
            near = int(np.argmin(after - before))
            mean, own = (rows.colour[before[near]] + rows.colour[after[near]]) / 2, rows.colour[row]
            end = mean if flanks is None else flanks[row]
            colour[row] = mean if np.linalg.norm(end - mean) < np.linalg.norm(end - own) else own
    if flanks is not None:
        below, above = colour[:-2], colour[2:]
        between = (below + above) / 2
        alone = (lengths(above - below) < _MIXED_DISTANCE) & (lengths(colour[1:-1] - between) > _MIXED_DISTANCE)
        colour[1:-1] = np.where((alone & ~rows.pattern[1:-1])[:, None], between, colour[1:-1])
    return replace(rows, colour=colour, outer=colour)


def with_bare_neck(rows: Rows, skin: F64) -> Rows:
    """Return a neck's rows with skin from its lowest bare row up, whatever beard or shadow of the chin is in front.

    ``skin`` [3] is the face's colour, in square roots of linear light.
    """
    colour, tolerance = rows.colour.copy(), rows.tolerance.copy()
    from_skin = unlike(colour, skin[None], _NECK_SHADING)
    nearest, light = int(from_skin.argmin()), lengths(colour)
    bare = (from_skin < from_skin[nearest] + MIN_TOLERANCE) & (light > (1 - _NECK_SHADING) * light[nearest])
    hue = unlike(colour, colour[nearest : nearest + 1], _CHIN_SHADOW)
    bare |= (hue < _SAME_HUE_DISTANCE) & (light > (1 - _CHIN_SHADOW) * light[nearest])
    first = int(bare.argmax())
    colour[first:], tolerance[first:] = colour[nearest], tolerance[nearest]
    return replace(rows, colour=colour, outer=colour, tolerance=tolerance)


def without_straps(rows: Rows, at: F64, look: F64, weight: F64) -> Rows:
    """Return a foot's rows in the ankle's colour where a sandal shows enough of it; the sole stays.

    Samples [K] of colour ``look`` [K, 3] and ``weight`` are ``at`` metres of height.
    """
    row, ankle, count = rows.index(at), rows.colour[-1], len(rows.colour)
    bare = np.bincount(row, weight * (lengths(look - ankle) < SAME_COLOUR_DISTANCE), count)
    share = bare / np.maximum(np.bincount(row, weight, count), 1e-9)
    some = (share > _MIN_SANDAL_SKIN_FRACTION) & (rows.places > rows.first + _SOLE_M)
    colour = np.where(some[:, None], ankle, rows.colour)
    return replace(rows, colour=colour, outer=colour)


def with_pattern_above(rows: Rows, place: float, reach: float) -> Rows:
    """Return the rows with a pattern from ``reach`` below ``place`` on if most rows between have one; both in metres.

    A neckline hides a pattern, and a row in which one of its colours prevails looks plain.
    """
    chest = rows.pattern[(rows.places > place - reach) & (rows.places < place)]
    if not len(chest) or chest.mean() <= 0.5:
        return rows
    return replace(rows, pattern=rows.pattern | (rows.places >= place - reach))


def without_unseen_edges(rows: Rows, at: F64, across: F64, look: F64) -> Rows:
    """Return the rows with soft turns where their main colours change at once but the picture's do not.

    Light that comes from one side and falls off down a leg does that, at no change of hue. Samples [K] of colour
    ``look`` [K, 3] are ``at`` metres along the limb and ``across`` it.
    """
    colour, count = rows.colour, len(rows.colour)
    strip = np.floor(across / _STRIP_M).astype(np.intp)
    row = np.round((at - rows.first) / ROW_M).astype(np.intp)
    change = np.full(count, np.nan)  # of the median strip; NaN where the main colour does not change
    for middle in range(_EDGE_ROWS, count - _EDGE_ROWS):
        below, above = colour[[middle - _EDGE_ROWS, middle + _EDGE_ROWS]]
        step, (dark, bright) = above - below, sorted((below, above), key=np.sum)
        if np.linalg.norm(step) < SAME_COLOUR_DISTANCE or unlike(dark[None], bright[None], 1.0)[0] > _TONE_DISTANCE:
            continue
        away = row - middle
        sides = [np.flatnonzero((side * away > 0) & (side * away <= _EDGE_ROWS)) for side in (-1, 1)]
        changes: list[float] = []
        for number in np.unique(strip[sides[0]]):
            low, high = (look[side[strip[side] == number]] for side in sides)
            if min(len(low), len(high)) >= _MIN_STRIP_SAMPLES:
                changes.append((high.mean(axis=0) - low.mean(axis=0)) @ step / (step @ step))
        change[middle] = np.median(changes) if changes else 0.0
    soft = np.zeros(count, bool)
    for edge in np.split(np.arange(count), np.flatnonzero(np.diff(np.isnan(change))) + 1):
        soft[edge] = change[edge].max() < _MIN_EDGE_SHARE and not rows.pattern[edge].any()
    if not soft.any():
        return rows
    around = np.ones(2 * _SOFT_ROWS + 1)
    padded = np.pad(colour, ((_SOFT_ROWS, _SOFT_ROWS), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(padded[:, k], around / len(around), mode="valid") for k in range(3)], axis=1)
    away = np.abs(np.arange(count)[:, None] - np.flatnonzero(soft)).min(axis=1)
    mixed = np.where((away <= _SOFT_ROWS + _EDGE_ROWS)[:, None], smooth, colour)
    return replace(rows, colour=mixed, outer=np.where(rows.outer == colour, mixed, rows.outer))


def dark_lines(rows: Rows, at: F64, across: F64, look: F64) -> F64:
    """Return [R] how much darker each row is than those beside it, in square roots of linear light.

    That of the median strip counts: belts and hems cross all of them. 0 for rows with too few samples, which are
    [K] of colour ``look`` [K, 3], ``at`` metres along the limb and ``across`` it.
    """
    lines, count = np.zeros(len(rows.colour)), len(rows.colour)
    if not len(at):
        return lines
    strip = np.floor((across - across.min()) / _STRIP_M).astype(np.intp)
    width = int(strip.max()) + 1
    cell = rows.index(at) * width + strip
    samples = np.bincount(cell, minlength=count * width)
    light = np.bincount(cell, look.mean(axis=1), minlength=count * width) / np.maximum(samples, 1)
    light = np.where(samples >= _MIN_LINE_SAMPLES, light, np.nan).reshape(count, width)
    for row in range(-_BESIDE_LINE_ROWS[0], count - _BESIDE_LINE_ROWS[-1]):
        darker = light[[row + away for away in _BESIDE_LINE_ROWS]].mean(axis=0) - light[row]
        darker = darker[np.isfinite(darker)]
        lines[row] = np.median(darker) if len(darker) >= _MIN_LINE_STRIPS else 0.0
    return lines


def in_one_tone(parts: Sequence[Rows]) -> list[Rows]:
    """Return the rows of parts that meet, in the mean colour of those nearby that are alike.

    What light and shadows change down a garment goes.
    """
    if not parts:
        return []
    place = np.concatenate([rows.places for rows in parts])
    colour = np.concatenate([rows.colour for rows in parts])
    toned = []
    for rows in parts:
        near = np.abs(rows.places[:, None] - place) <= _TONE_M
        alike = near & np.stack([unlike(colour, own[None]) < _TONE_DISTANCE for own in rows.colour])
        mean = alike @ colour / alike.sum(axis=1, keepdims=True)
        outer = np.where(rows.outer == rows.colour, mean, rows.outer)
        tolerance = rows.tolerance + lengths(mean - rows.colour)
        toned.append(replace(rows, colour=mean, outer=outer, tolerance=tolerance))
    return toned
