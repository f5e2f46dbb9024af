"""Whether a garment's pattern goes around the body: stripes, checks and borders do, a sign on its front does not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["goes_around"]

F64 = NDArray[np.float64]

_PARTS = 7  # of the width that is seen
_ENDS = 0.02  # quantile of the samples at either end of it
_UNLIKE = 0.1  # square roots of linear light: what is farther from a part's usual colour is of another one
_GARMENT, _ALIKE = 18, 0.15  # rows up and down, of colours so near, are the same piece of cloth
_LEAST = 0.05  # of a part that is of other colours in cloth with a pattern
_OUTERMOST = 0.6  # against the mean of the parts: so much of that the first and the last part have
_FEWEST, _ENOUGH = 2.0, 4  # summed trust of a part that is seen; so many of them
_ASLANT = 0.4  # trust of the outermost part against the other outermost one: less is seen aslant


def goes_around(colour: F64, row: NDArray[np.intp], across: F64, look: F64, trust: F64) -> NDArray[np.bool_]:
    """[R] whether rows of ``colour`` [R, 3] belong to cloth that has other colours, at its sides as in its middle.

    Of the samples [K] ``row`` is which row they are in, ``across`` how far to the side, ``look`` [K, 3] their
    colours, square roots of linear light as ``colour`` is, and ``trust`` what they say.
    """
    order = np.argsort(row, kind="stable")
    row, across, look, trust = row[order], across[order], look[order], trust[order]
    count = len(colour)
    starts = np.searchsorted(row, np.arange(count + 1))
    part, away = _parts(starts, across), look - colour[row]
    # rows that arms hide are none: what is seen above them goes on below
    number = np.cumsum(np.bincount(row, trust, minlength=count) > _FEWEST)
    first = np.searchsorted(number, number - _GARMENT, "left")
    last = np.searchsorted(number, number + _GARMENT, "right")
    same = np.abs(number[:, None] - number) <= _GARMENT
    same &= np.linalg.norm(colour[:, None] - colour, axis=2) < _ALIKE
    around, asked = np.zeros(count, bool), np.zeros(count, bool)
    for at in range(count):
        near = slice(starts[first[at]], starts[last[at]])
        of_it = near.start + np.flatnonzero(same[at][row[near]])
        parts = [of_it[part[of_it] == place] for place in range(_PARTS)]
        seen = [float(trust[mine].sum()) for mine in parts]
        ends = [0, _PARTS - 1]
        if min(seen[0], seen[-1]) < _ASLANT * max(seen[0], seen[-1]):  # of somebody turned one side speaks for both
            far = int(seen[-1] < seen[0])
            seen[ends.pop(far)] = 0.0
        other = {k: _other(away[mine], trust[mine]) for k, mine in enumerate(parts) if seen[k] >= _FEWEST}
        asked[at] = len(other) >= _ENOUGH
        if asked[at] and min(other.values()) > _LEAST and all(end in other for end in ends):
            around[at] = min(other[end] for end in ends) > _OUTERMOST * np.mean(list(other.values()))
    cloth = same.astype(float)
    # most rows of a garment that are seen speak for all
    return np.asarray(cloth @ around > 0.5 * (cloth @ asked))


def _other(away: F64, trust: F64) -> float:
    """Share of a part's samples [N] that are not of its usual colour; 0 where that is another thing's."""
    low, high = (len(away) - 1) // 2, len(away) // 2
    middle = np.partition(away, (low, high), axis=0)
    usual = (middle[low] + middle[high]) / 2  # the median: the light's, which falls off to a side
    if np.linalg.norm(usual) > _ALIKE:
        return 0.0
    off = away - usual
    return float(trust[np.einsum("nc,nc->n", off, off) > _UNLIKE**2].sum() / trust.sum())


def _parts(starts: NDArray[np.intp], across: F64) -> NDArray[np.intp]:
    """[K] which part of its row's width each sample lies in; rows begin at ``starts`` [R + 1]."""
    part = np.zeros(len(across), np.intp)
    for first, end in pairwise(starts):
        if end > first:
            low, high = np.quantile(across[first:end], (_ENDS, 1 - _ENDS))
            share = (across[first:end] - low) / max(float(high - low), 1e-6)
            part[first:end] = (share * _PARTS).clip(0, _PARTS - 1)
    return part
