"""Methods compared over the same participants: who is better, by how much, and how sure that is.

Values are figures of one measure, by method and participant. What is absent, None or not finite counts as missing; a
participant counts for a pair of methods where both have a figure.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from glsplat.extras.statistics.bootstrap import interval_of_mean
from glsplat.extras.statistics.holm import holm
from glsplat.extras.statistics.ranks import rank_biserial, wilcoxon

Values = Mapping[str, Mapping[str, float | None]]
"""Figures of one measure, by method and participant."""


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


def _corrected(rows: list[Paired]) -> list[Paired]:
    tested = [row.p for row in rows if row.p is not None]
    corrected = iter(holm(tested))
    return [replace(row, p_holm=next(corrected)) if row.p is not None else row for row in rows]


def _participants(values: Values) -> list[str]:
    """Everybody whom some method names, by name: resampling goes by place."""
    return sorted({name for own in values.values() for name in own})


def _known(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
