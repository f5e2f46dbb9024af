"""Methods compared over the same participants: who is better, by how much, and how sure that is.

Values are figures of one measure, by method and participant. What is absent, None or not finite counts as missing; a
participant counts for a pair of methods where both have a figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import rankdata

__all__ = [
    "Paired",
    "Summary",
    "Values",
    "compare",
    "holm",
    "interval_of_mean",
    "rank_biserial",
    "summarise",
    "wilcoxon",
]

Values = Mapping[str, Mapping[str, float | None]]
"""Figures of one measure, by method and participant."""
F64 = NDArray[np.float64]

RESAMPLES = 10_000
LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Summary:
    """One method: over how many participants, and what is known of it with so many (else None)."""

    method: str
    n: int
    missing: tuple[str, ...]
    """Participants that another method has."""
    mean: float | None
    deviation: float | None
    """Standard deviation of a sample (n - 1)."""
    low: float | None
    high: float | None
    """95 % interval of the mean."""


@dataclass(frozen=True, slots=True)
class Paired:
    """Two methods over the participants that both have. Differences are first less second."""

    first: str
    second: str
    n: int
    missing: tuple[str, ...]
    """Participants that were left out."""
    mean: float | None
    low: float | None
    high: float | None
    """95 % interval of the mean difference."""
    median: float | None
    effect: float | None
    """Matched-pairs rank-biserial correlation: 1 where the first is larger in everybody, -1 where the second is."""
    p: float | None
    """Wilcoxon's signed-rank test, two-sided."""
    p_holm: float | None
    """Corrected for all pairs of this comparison."""


def summarise(values: Values, seed: int = 0) -> list[Summary]:
    """A row a method, in the order of ``values``."""
    everybody = _participants(values)
    rows = []
    for method, own in values.items():
        known = {name: value for name in everybody if (value := _known(own.get(name))) is not None}
        sample = np.array(list(known.values()))
        low, high = interval_of_mean(sample, seed)
        rows.append(
            Summary(
                method,
                len(sample),
                tuple(name for name in everybody if name not in known),
                float(sample.mean()) if len(sample) else None,
                float(sample.std(ddof=1)) if len(sample) > 1 else None,
                low,
                high,
            )
        )
    return rows


def compare(values: Values, seed: int = 0) -> list[Paired]:
    """A row for each pair of methods, in the order of ``values``; all pairs are one family of tests.

    The same values and seed give the same rows, and a further method changes nothing but ``p_holm``.
    """
    everybody = _participants(values)
    rows = []
    for first, second in combinations(values, 2):
        both = {name: (_known(values[first].get(name)), _known(values[second].get(name))) for name in everybody}
        pairs = [(a, b) for a, b in both.values() if a is not None and b is not None]
        missing = tuple(name for name, pair in both.items() if None in pair)
        difference = np.array([a - b for a, b in pairs])
        low, high = interval_of_mean(difference, seed)
        n = len(pairs)
        rows.append(
            Paired(
                first,
                second,
                n,
                missing,
                float(difference.mean()) if n else None,
                low,
                high,
                float(np.median(difference)) if n else None,
                rank_biserial(difference) if n else None,
                wilcoxon(difference) if n else None,
                None,
            )
        )
    return _corrected(rows)


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


def holm(p: Sequence[float]) -> list[float]:
    """p values corrected for being several (Holm 1979), in their order."""
    corrected = [0.0] * len(p)
    worst = 0.0
    for place, index in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        worst = max(worst, min(1.0, (len(p) - place) * p[index]))
        corrected[index] = worst
    return corrected


def interval_of_mean(sample: F64, seed: int = 0) -> tuple[float | None, float | None]:
    """95 % bootstrap interval (BCa, Efron 1987; 10,000 resamples) of the mean of [N]; (None, None) for fewer than 2."""
    n = len(sample)
    if n < 2:
        return None, None
    if sample.min() == sample.max():
        return float(sample[0]), float(sample[0])
    mean = sample.mean()
    away = sample - mean
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))
    means = away[drawn].mean(axis=1)
    below = ((means < 0).mean() + (means <= 0).mean()) / 2
    bias = ndtri(np.clip(below, 0.5 / RESAMPLES, 1 - 0.5 / RESAMPLES))
    skew = (away**3).sum() / (6 * (away**2).sum() ** 1.5)  # of the means without one participant
    normal = bias + ndtri(np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2]))
    low, high = np.quantile(means, ndtr(bias + normal / (1 - skew * normal)))
    return float(mean + low), float(mean + high)


def _ranked(differences: F64) -> tuple[F64, F64]:
    """Ranks of the sizes and signs of the differences that are not zero."""
    some = differences[differences != 0]
    return np.asarray(rankdata(np.abs(some)), np.float64), np.sign(some)


def _corrected(rows: list[Paired]) -> list[Paired]:
    tested = [row.p for row in rows if row.p is not None]
    corrected = iter(holm(tested))
    return [replace(row, p_holm=next(corrected)) if row.p is not None else row for row in rows]


def _participants(values: Values) -> list[str]:
    """Everybody whom some method names, by name: resampling goes by place."""
    return sorted({name for own in values.values() for name in own})


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
