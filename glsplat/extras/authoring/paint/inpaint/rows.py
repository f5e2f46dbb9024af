"""Cut cloth along a limb into rows, and find the main colour of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.dress.coat import unlike
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

_KERNEL_SIGMA, _SHIFT_STEPS = 0.08, 6  # of mean shift
_MIXED_TOLERANCE, _MIXED_ROWS = 0.139, 12  # of a row of several colours; between the rows it is compared with
_MIXED_DISTANCE = 0.1  # from these, at least, and between them, at most
_TONE_M, _TONE_DISTANCE = 0.12, 0.05  # between rows whose colours become one, and between these but for their light


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


def rows_of(axis: int, ends: tuple[float, float], at: F64, look: F64, weight: F64, reach: float) -> Rows | None:
    """Return the rows between ``ends`` (metres) from samples ``at`` [K] metres; None if none has enough of them.

    A row takes samples within ``reach`` metres.
    """
    count = max(2, int(np.ceil((ends[1] - ends[0]) / ROW_M)) + 1)
    order = np.argsort(at, kind="stable")
    at, look, weight = at[order], look[order], weight[order]
    colour, tolerance, known = np.zeros((count, 3)), np.zeros(count), np.zeros(count, bool)
    for row in range(count):
        middle = ends[0] + row * ROW_M
        some = slice(*np.searchsorted(at, (middle - reach, middle + reach)))
        if weight[some].sum() < MIN_ROW_WEIGHT:
            continue
        colour[row], spread = main_colour(look[some], weight[some])
        tolerance[row] = tolerance_of(spread)
        known[row] = True
        if not np.isfinite(reach):
            colour[:], tolerance[:], known[:] = colour[row], tolerance[row], True
            break
    if not known.any():
        return None
    rows = np.arange(count)
    colour = np.stack([np.interp(rows, rows[known], colour[known, k]) for k in range(3)], axis=1)
    tolerance = np.interp(rows, rows[known], tolerance[known])
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

    Rows of a pattern stay, and those that have their colour at their ends, too, ``flanks`` [R, 3]: a bare belly.
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
    return replace(rows, colour=colour, outer=colour)


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
