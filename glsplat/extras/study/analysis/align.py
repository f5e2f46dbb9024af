"""The aligned rank transform (ART): remove all effects but one from the answers, then rank them to test that effect.

Wobbrock, Findlater, Gergle and Higgins (2011), "The aligned rank transform for nonparametric factorial analyses using
only ANOVA procedures"; for contrasts Elkin, Kay, Higgins and Wobbrock (2021), "An aligned rank transform procedure for
multifactor contrast tests" (ART-C). Means weight all answers equally, as in ARTool, also in unbalanced designs.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.statistics.ranks import TIE, average_ranks

from .effects import Effect
from .table import Table

DRAWS = 25


def aligned(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return residuals plus the estimated effect (Wobbrock et al. 2011, steps 1 to 3), [..., N].

    ``values``: other answers on the same rows, [..., N]. The estimate is the alternating sum of the means over all
    subsets of the effect's factors.
    """
    y = table.values if values is None else values
    out = y - _means(table, tuple(range(len(table.factors))), y)
    for size in range(len(effect) + 1):
        for subset in combinations(effect, size):
            out = out + (-1) ** (len(effect) - size) * _means(table, subset, y)
    return out


def ranked(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return the ranks of :func:`aligned` from 1, mean ranks for ties, [..., N]."""
    return average_ranks(_settled(aligned(table, effect, values), table.values if values is None else values))


def spread_ranks(table: Table, effect: Effect, step: float, values: F64 | None = None, seed: int = 0) -> F64:
    """Return aligned ranks averaged over 25 draws that spread each answer evenly over one ``step``, [..., N].

    On a coarse scale alignment splits ties along the estimated effect, and ranking enlarges the split: ART finds
    effects that do not exist (Luepsen 2017, "The aligned rank transform and discrete variables: a warning"). Spread
    answers have no ties. ARTool does not do this.
    """
    y = table.values if values is None else values
    rng = np.random.default_rng(seed)
    total = np.zeros(y.shape)
    for _ in range(DRAWS):
        total += average_ranks(aligned(table, effect, y + step * (rng.random(y.shape) - 0.5)))
    return total / DRAWS


def step_of(values: F64) -> float | None:
    """Return the smallest difference between answers [N] on a scale; None if fewer than half are tied, or all."""
    known, counts = np.unique(average_ranks(values), return_counts=True)
    if len(known) < 2 or counts[counts > 1].sum() < len(values) / 2:
        return None
    ordered = np.sort(values)
    gaps = np.diff(ordered)
    return float(gaps[gaps > TIE * np.abs(values).max()].min())


def aligned_for_contrasts(table: Table, effect: Effect, values: F64 | None = None) -> F64:
    """Return answers aligned as if the combinations of the effect's levels were one factor (ART-C), [..., N]."""
    y = table.values if values is None else values
    whole = tuple(range(len(table.factors)))
    return y - _means(table, whole, y) + _means(table, effect, y) - _means(table, (), y)


def ranked_for_contrasts(table: Table, effect: Effect) -> F64:
    """Return the ranks of :func:`aligned_for_contrasts`, [..., N]."""
    return average_ranks(_settled(aligned_for_contrasts(table, effect), table.values))


def _settled(out: F64, y: F64) -> F64:
    """Return aligned values with those within rounding error of the answers ``y`` set to 0, so that they are tied."""
    size = np.abs(y).max(axis=-1, keepdims=True, initial=0.0)
    return np.where(np.abs(out) <= 1e-12 * size, 0.0, out)


def _means(table: Table, subset: Effect, y: F64) -> F64:
    """Return each row's mean over all rows with the same levels of these factors, [..., N]."""
    if not subset:
        return np.broadcast_to(y.mean(axis=-1, keepdims=True), y.shape)
    place = np.ravel_multi_index(tuple(table.codes[:, i] for i in subset), tuple(table.shape[i] for i in subset))
    member = np.zeros((len(place), int(place.max()) + 1))
    member[np.arange(len(place)), place] = 1
    return (y @ (member / np.maximum(member.sum(axis=0), 1)))[..., place]
