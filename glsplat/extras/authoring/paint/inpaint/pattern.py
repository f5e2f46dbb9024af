"""Decide whether a garment's pattern goes around the body: stripes and checks do, a print on the front does not."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from glsplat.extras.authoring.dress.skirt import unlike

F64 = NDArray[np.float64]

_PARTS = 7  # of the visible width
_END_QUANTILE = 0.02  # of the samples at either end of the width
_MIN_CONTRAST = 0.1  # square roots of linear light, between a part's usual colour and another one
_GARMENT_ROWS, _GARMENT_CONTRAST = 18, 0.15  # rows nearer and more alike than this are the same piece of cloth
_MIN_PATTERN_ROWS = 8  # fewer are a hem, a strap or a belt
_SHADING = 0.1  # of folds and shadows, whose differences do not count
_MIN_OTHER_FRACTION = 0.05  # of a part of patterned cloth that has other colours; the middle may be a border of buttons
_MIN_END_FACTOR = 0.6  # other colours of the first and the last part over the mean of all parts
_MIN_PART_WEIGHT, _MIN_PARTS = 2.0, 4  # summed visibility of a part; number of such parts
_OBLIQUE_FACTOR = 0.4  # visibility of one end over the other's: below, only the better visible end counts


def goes_around(colour: F64, row: NDArray[np.intp], across: F64, look: F64, visibility: F64) -> NDArray[np.bool_]:
    """Return [R] whether rows of ``colour`` [R, 3] belong to cloth with other colours at its sides and middle.

    Samples [K] have a ``row``, a place ``across``, colours ``look`` [K, 3] in square roots of linear light, as
    ``colour``, and a ``visibility``.
    """
    order = np.argsort(row, kind="stable")
    row, across, look, visibility = row[order], across[order], look[order], visibility[order]
    count = len(colour)
    starts = np.searchsorted(row, np.arange(count + 1))
    part, own = _parts(starts, across), colour[row]
    difference = look - own
    # rows hidden by arms are skipped: cloth above them goes on below
    number = np.cumsum(np.bincount(row, visibility, minlength=count) > _MIN_PART_WEIGHT)
    first = np.searchsorted(number, number - _GARMENT_ROWS, "left")
    last = np.searchsorted(number, number + _GARMENT_ROWS, "right")
    same = np.abs(number[:, None] - number) <= _GARMENT_ROWS
    same &= np.linalg.norm(colour[:, None] - colour, axis=2) < _GARMENT_CONTRAST
    around, tested = np.zeros(count, bool), np.zeros(count, bool)
    for index in range(0, count, 2):  # its neighbours' garment is nearly the same
        near = slice(starts[first[index]], starts[last[index]])
        samples = near.start + np.flatnonzero(same[index][row[near]])
        parts = [samples[part[samples] == place] for place in range(_PARTS)]
        weights = [float(visibility[mine].sum()) for mine in parts]
        ends = [0, _PARTS - 1]
        near_end, far_end = sorted((weights[0], weights[-1]), reverse=True)
        if far_end < _OBLIQUE_FACTOR * near_end:  # a turned person shows one side only
            weights[ends.pop(int(weights[-1] < weights[0]))] = 0.0
        shown = [k for k in range(_PARTS) if weights[k] >= _MIN_PART_WEIGHT]
        other = {k: _other_fraction(difference[parts[k]], own[parts[k]], visibility[parts[k]]) for k in shown}
        tested[index] = len(other) >= _MIN_PARTS
        beside = [other[k] for k in other if k != _PARTS // 2]
        if tested[index] and min(beside) > _MIN_OTHER_FRACTION and all(end in other for end in ends):
            around[index] = min(other[end] for end in ends) > _MIN_END_FACTOR * np.mean(list(other.values()))
    around[1::2], tested[1::2] = around[: count - 1 : 2], tested[: count - 1 : 2]
    cloth = same.astype(float)
    # by a majority of a garment's visible rows
    return binary_opening(cloth @ around > 0.5 * (cloth @ tested), np.ones(_MIN_PATTERN_ROWS, bool))


def _other_fraction(difference: F64, colour: F64, visibility: F64) -> float:
    """Return the fraction of a part's samples [N] not in its usual colour; 0 if that belongs to another garment.

    ``difference`` [N, 3] is from the ``colour`` [N, 3] of the sample's row.
    """
    low, high = (len(difference) - 1) // 2, len(difference) // 2
    middle = np.partition(difference, (low, high), axis=0)
    usual = (middle[low] + middle[high]) / 2  # the median: light falls off to a side
    if np.linalg.norm(usual) > _GARMENT_CONTRAST:
        return 0.0
    off = unlike(colour + difference - usual, colour, _SHADING)
    return float(visibility[off > _MIN_CONTRAST].sum() / visibility.sum())


def _parts(starts: NDArray[np.intp], across: F64) -> NDArray[np.intp]:
    """Return [K] the part of its row's width that each sample lies in; rows begin at ``starts`` [R + 1]."""
    part = np.zeros(len(across), np.intp)
    for first, end in pairwise(starts):
        if end > first:
            low, high = np.quantile(across[first:end], (_END_QUANTILE, 1 - _END_QUANTILE))
            share = (across[first:end] - low) / max(float(high - low), 1e-6)
            part[first:end] = (share * _PARTS).clip(0, _PARTS - 1)
    return part
