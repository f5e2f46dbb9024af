"""Compare methods over the same participants: differences, intervals, effect sizes and tests.

Absent, None and non-finite values are missing; a participant counts for a pair of methods that both have a value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from glsplat.extras.statistics.nonparametric import holm, interval_of_mean, rank_biserial, wilcoxon

Values = Mapping[str, Mapping[str, float | None]]
"""Values of one measure, by method and participant."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of one method over ``n`` participants; None if they need more."""

    method: str
    n: int
    missing: tuple[str, ...]  # participants that only other methods have
    mean: float | None
    deviation: float | None  # sample standard deviation (n - 1)
    low: float | None
    high: float | None  # 95 % interval of the mean


@dataclass(frozen=True, slots=True)
class Paired:
    """Comparison of two methods on their common participants; differences are ``first - second``."""

    first: str
    second: str
    n: int
    missing: tuple[str, ...]  # participants that lack a value
    mean: float | None
    low: float | None
    high: float | None  # 95 % interval of the mean difference
    median: float | None
    effect: float | None
    """Matched-pairs rank-biserial correlation: 1 if the first is larger in everybody, -1 if the second is."""
    p: float | None  # of Wilcoxon's signed-rank test, two-sided
    p_holm: float | None  # ``p`` corrected for all pairs


def summarise(values: Values, seed: int = 0) -> list[Summary]:
    """Return a row per method, in the order of ``values``."""
    everybody = _participants(values)
    rows = []
    for method, own in values.items():
        known = {name: value for name in everybody if (value := _known(own.get(name))) is not None}
        sample = np.array(list(known.values()))
        low, high = interval_of_mean(sample, seed)
        missing = tuple(name for name in everybody if name not in known)
        mean = float(sample.mean()) if len(sample) else None
        deviation = float(sample.std(ddof=1)) if len(sample) > 1 else None
        rows.append(Summary(method, len(sample), missing, mean, deviation, low, high))
    return rows


def compare(values: Values, seed: int = 0) -> list[Paired]:
    """Return a row per pair of methods, in the order of ``values``; all pairs are one family of tests.

    The same values and seed give the same rows; another method changes only ``p_holm``.
    """
    everybody = _participants(values)
    rows = []
    for first, second in combinations(values, 2):
        both = {name: (_known(values[first].get(name)), _known(values[second].get(name))) for name in everybody}
        pairs = [(a, b) for a, b in both.values() if a is not None and b is not None]
        missing = tuple(name for name, pair in both.items() if None in pair)
        difference = np.array([a - b for a, b in pairs])
        low, high = interval_of_mean(difference, seed)
        row = Paired(first, second, len(pairs), missing, None, low, high, None, None, None, None)
        if pairs:
            mean, median = float(difference.mean()), float(np.median(difference))
            effect, p = rank_biserial(difference), wilcoxon(difference)
            row = replace(row, mean=mean, median=median, effect=effect, p=p)
        rows.append(row)
    corrected = iter(holm([row.p for row in rows if row.p is not None]))
    return [row if row.p is None else replace(row, p_holm=next(corrected)) for row in rows]


def _participants(values: Values) -> list[str]:
    """Return the participants of all methods, sorted, as resampling depends on the order."""
    return sorted({name for own in values.values() for name in own})


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
