"""Ranks with mean ranks for ties, and what rests on them alone: Wilcoxon's signed-rank test and its effect size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["average_ranks", "rank_biserial", "wilcoxon"]

F64 = NDArray[np.float64]

TIE = 1e-9
"""Values that lie no farther apart than this share of the largest size are one value: sums round differently."""


def average_ranks(values: F64) -> F64:
    """Ranks from 1 along the last axis of [..., N]; of equal values, their mean rank.

    Equal is what differs by rounding alone (:data:`TIE`): aligned values come from sums, and a tie has to stay one.
    """
    order = np.argsort(values, axis=-1, kind="stable")
    ordered = np.take_along_axis(values, order, -1)
    count = values.shape[-1]
    tolerance = TIE * np.abs(values).max(axis=-1, keepdims=True, initial=0.0)
    begins = np.ones(values.shape, bool)
    begins[..., 1:] = np.diff(ordered, axis=-1) > tolerance
    ends = np.ones(values.shape, bool)
    ends[..., :-1] = begins[..., 1:]
    places = np.arange(count)
    first = np.maximum.accumulate(np.where(begins, places, 0), axis=-1)
    last = np.minimum.accumulate(np.where(ends, places, count)[..., ::-1], axis=-1)[..., ::-1]
    ranks = np.empty(values.shape)
    np.put_along_axis(ranks, order, (first + last) / 2 + 1, -1)
    return ranks


def wilcoxon(differences: F64) -> float:
    """Two-sided p of the signed-rank test, exact: over all signs that the differences [N] could have had.

    Zeros are left out, as Wilcoxon did; equal sizes share their mean rank. scipy's own test is exact without equal
    sizes only, and what it does instead depends on its version.
    """
    ranks, signs = _ranked(differences)
    doubled = np.rint(2 * ranks).astype(int)  # mean ranks are halves at worst
    total = int(doubled.sum())
    chance = np.zeros(total + 1)  # of each sum of the ranks that got a plus
    chance[0] = 1
    for rank in doubled:
        moved = np.zeros_like(chance)
        moved[rank:] = chance[: total + 1 - rank]
        chance = (chance + moved) / 2
    plus = int(doubled[signs > 0].sum())
    return min(1.0, 2 * float(chance[: min(plus, total - plus) + 1].sum()))


def rank_biserial(differences: F64) -> float:
    """The sum of the ranks with a plus less that with a minus, as a share of all; 0 where all differences are."""
    ranks, signs = _ranked(differences)
    return float((ranks * signs).sum() / ranks.sum()) if len(ranks) else 0.0


def _ranked(differences: F64) -> tuple[F64, F64]:
    """Ranks of the sizes and signs of the differences that are not zero."""
    sizes = np.abs(differences)
    some = differences[sizes > TIE * sizes.max(initial=0.0)]
    return average_ranks(np.abs(some)), np.sign(some)
