"""Rows of cloth along a limb: the one colour that most of each of them shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import component_sums, lengths

__all__ = ["ALIKE", "FEWEST", "STEP", "TOLERANCE", "Rows", "most_of", "rows_of", "steady"]

F64 = NDArray[np.float64]

STEP = 0.01
"""Metres of a row."""

FEWEST = 6.0
"""Summed trust of a row that is believed."""

TOLERANCE: tuple[float, float, float] = 0.06, 2.0, 0.14
"""Least, in spreads of a row, most: how far a colour may lie from it, in square roots of linear light."""

ALIKE = 0.15
"""Colours nearer to each other than that are not told apart."""

_KERNEL, _SHIFTS = 0.08, 6
_MOTLEY, _APART = 0.139, 4  # tolerance of a row of several colours; rows to those above and below it


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Of one region, R of them."""

    axis: int
    first: float  # metres of the first row
    colour: F64  # [R, 3] square roots
    tolerance: F64  # [R]
    outer: F64  # [R, 3] square roots, of what lies farther from the middle than ``edge``
    edge: F64  # [R] metres
    pattern: NDArray[np.bool_]  # [R]

    @property
    def places(self) -> F64:
        """[R] metres along the axis."""
        return np.asarray(self.first + STEP * np.arange(len(self.colour)))


def rows_of(axis: int, ends: tuple[float, float], at: F64, look: F64, weight: F64, reach: float) -> Rows | None:
    """The rows between two ``ends`` in metres of samples ``at`` [K]; None where none has enough of them."""
    count = max(2, int(np.ceil((ends[1] - ends[0]) / STEP)) + 1)
    order = np.argsort(at, kind="stable")
    at, look, weight = at[order], look[order], weight[order]
    colour, tolerance, known = np.zeros((count, 3)), np.zeros(count), np.zeros(count, bool)
    for row in range(count):
        middle = ends[0] + row * STEP
        some = slice(*np.searchsorted(at, (middle - reach, middle + reach)))
        if weight[some].sum() < FEWEST:
            continue
        colour[row], spread = most_of(look[some], weight[some])
        tolerance[row] = np.clip(TOLERANCE[1] * spread, TOLERANCE[0], TOLERANCE[2])
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


def most_of(look: F64, weight: F64) -> tuple[F64, float]:
    """[3] the colour that most of the samples have, and how far half of them lie from it."""
    mode = np.median(look[weight >= np.median(weight)], axis=0)
    for _ in range(_SHIFTS):
        near = weight * np.exp(-0.5 * component_sums((look - mode) ** 2) / _KERNEL**2)
        mode = (near[:, None] * look).sum(axis=0) / max(float(near.sum()), 1e-12)
    away = lengths(look - mode)
    order = np.argsort(away, kind="stable")
    total = np.cumsum(weight[order])
    return mode, float(away[order[np.searchsorted(total, 0.5 * total[-1])]])


def steady(rows: Rows) -> Rows:
    """Without rows of several colours between two that agree, such as where a hem hangs aslant."""
    count, colour = len(rows.colour), rows.colour.copy()
    number = np.arange(count)
    before, after = rows.colour[(number - _APART).clip(0)], rows.colour[(number + _APART).clip(None, count - 1)]
    odd = (rows.tolerance > _MOTLEY) & (np.linalg.norm(before - after, axis=1) < ALIKE)
    odd &= np.linalg.norm(rows.colour - before, axis=1) > ALIKE
    colour[odd] = (before[odd] + after[odd]) / 2
    return replace(rows, colour=colour, outer=colour)
