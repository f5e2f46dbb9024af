"""Plain nonparametric tests, one factor at a time, and effect sizes with confidence intervals.

The tests are Friedman and Wilcoxon, Kruskal-Wallis and Mann-Whitney. Each participant counts once per level, by the
mean over all other factors. Interactions are not tested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtrc, ncfdtr
from scipy.stats import kruskal, mannwhitneyu

from glsplat.arrays import F64
from glsplat.extras.statistics.nonparametric import LEVEL, RESAMPLES, TIE, average_ranks, holm, rank_biserial, wilcoxon

from .anova import conditions, name_of
from .repeated import split
from .table import Effect, Table, averages

MOST_CONDITIONS = 24
"""Largest number of conditions of an effect whose pairs are compared: 276 pairs."""


@dataclass(frozen=True)
class EffectSize:
    """A value and its 95 % interval; NaN where undefined."""

    value: float
    low: float
    high: float


def partial_eta_squared(f: float, df1: float, df2: float) -> EffectSize:
    """Return F df1 / (F df1 + df2), with an interval from noncentral F distributions.

    Steiger (2004), "Beyond the F test": limits l of the noncentrality become l / (l + df1 + df2 + 1). For
    within-subject effects this is the usual approximation.
    """
    nan = float("nan")
    if not (np.isfinite(f) and df2 > 0):
        return EffectSize(1.0 if f == np.inf else nan, nan, nan)
    limits = [_noncentrality(f, df1, df2, (1 + LEVEL) / 2), _noncentrality(f, df1, df2, (1 - LEVEL) / 2)]
    low, high = (limit / (limit + df1 + df2 + 1) for limit in limits)
    return EffectSize(f * df1 / (f * df1 + df2), low, high)


def _noncentrality(f: float, df1: float, df2: float, share: float) -> float:
    """Return the noncentrality at which P(F < f) is ``share``; 0 if P(F < f) of the central F is less."""

    def above(noncentrality: float) -> float:
        return float(ncfdtr(df1, df2, noncentrality, f)) - share

    if above(0.0) <= 0:
        return 0.0
    top = 10.0 + 2 * f * df1
    while above(top) > 0:
        top *= 2
    return float(brentq(above, 0.0, top, xtol=1e-10, rtol=1e-12))


@lru_cache(maxsize=8)
def _resampled(count: int, seed: int) -> F64:
    """Return how often each of ``count`` participants is in each bootstrap sample, [RESAMPLES, count]."""
    drawn = np.random.default_rng(seed).multinomial(count, np.full(count, 1 / count), RESAMPLES).astype(float)
    drawn.flags.writeable = False
    return drawn


def cliffs_delta(first: F64, second: F64, *, paired: bool, seed: int = 0) -> EffectSize:
    """Return Cliff's delta, P(first > second) - P(first < second), of answers [N] and [M].

    Cliff (1993), "Dominance statistics". The interval is the percentiles of 10,000 bootstrap samples of participants.
    ``paired``: both arrays have the same participants in the same order, who are resampled together.
    """
    nan = float("nan")
    if not len(first) or not len(second):
        return EffectSize(nan, nan, nan)
    apart = first[:, None] - second
    size = max(np.abs(first).max(), np.abs(second).max())
    larger = np.where(np.abs(apart) <= TIE * size, 0.0, np.sign(apart))
    n, m = len(first), len(second)
    one = _resampled(n, seed)
    other = one if paired else _resampled(m, seed + 1)
    drawn = ((one @ larger) * other).sum(axis=1) / (n * m)
    low, high = np.quantile(drawn, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return EffectSize(float(larger.mean()), float(low), float(high))


@dataclass(frozen=True)
class Pair:
    """A test of ``first - second``: Wilcoxon's signed ranks (exact), or Mann-Whitney between participants."""

    effect: str
    first: str
    second: str
    test: str
    n: int
    p: float
    p_holm: float
    rank_biserial: float | None
    delta: EffectSize  # Cliff's delta


@dataclass(frozen=True)
class Omnibus:
    """A test of all levels of a factor; ``pairs`` are one family for Holm."""

    effect: str
    test: str
    n: int
    statistic: float
    df: int
    p: float
    pairs: tuple[Pair, ...]


def plain_tests(table: Table, seed: int = 0) -> list[Omnibus]:
    """Return a test for each factor, and one of all within conditions if there are several within factors.

    ``table`` has to be complete: every participant has every condition.
    """
    parts = split(table, table.values)
    out = []
    effects: list[Effect] = [(i,) for i in range(len(table.factors))]
    if len(table.within) > 1 and np.prod(parts.within_shape) <= MOST_CONDITIONS:
        effects.append(table.within)
    for effect in effects:
        name, labels = name_of(table, effect), conditions(table, effect)
        if effect[0] in table.within:
            inside = tuple(table.within.index(i) for i in effect)
            columns = list((parts.values @ averages(parts.within_shape, inside).T).T)
            paired = True
        else:
            code = np.unravel_index(parts.group, parts.between_shape)[table.between.index(effect[0])]
            columns = [parts.values[code == i].mean(axis=1) for i in range(len(labels))]
            paired = False
        statistic, df, p = friedman(np.stack(columns, 1)) if paired else kruskal_wallis(columns)
        made = [
            _pair(name, labels[a], labels[b], columns[a], columns[b], paired, seed)
            for a, b in combinations(range(len(labels)), 2)
        ]
        corrected = holm([pair.p for pair in made])
        pairs = tuple(replace(pair, p_holm=value) for pair, value in zip(made, corrected, strict=True))
        test = "Friedman" if paired else "Kruskal-Wallis"
        out.append(Omnibus(name, test, len(table.names), statistic, df, p, pairs))
    return out


def friedman(answers: F64) -> tuple[float, int, float]:
    """Return statistic, degrees of freedom and p of answers [N, K], corrected for ties (Conover 1999).

    If all are tied, statistic and p are 0 and 1. scipy.stats.friedmanchisquare refuses K = 2.
    """
    k = answers.shape[1]
    ranks = average_ranks(answers) - (k + 1) / 2
    spread = float((ranks**2).sum())
    statistic = (k - 1) * float((ranks.sum(axis=0) ** 2).sum()) / spread if spread else 0.0
    return statistic, k - 1, float(chdtrc(k - 1, statistic))


def kruskal_wallis(groups: list[F64]) -> tuple[float, int, float]:
    """Return statistic, degrees of freedom and p, corrected for ties; if all are tied, statistic 0 and p 1."""
    ranks = average_ranks(np.concatenate(groups))  # keep values tied that differ only by rounding
    if np.ptp(ranks) == 0:
        return 0.0, len(groups) - 1, 1.0
    ends = np.cumsum([len(group) for group in groups])[:-1]
    found = kruskal(*np.split(ranks, ends))
    return float(found.statistic), len(groups) - 1, float(found.pvalue)


def _pair(effect: str, first: str, second: str, a: F64, b: F64, paired: bool, seed: int) -> Pair:
    delta = cliffs_delta(a, b, paired=paired, seed=seed)
    if paired:
        p = wilcoxon(a - b)
        return Pair(effect, first, second, "Wilcoxon", len(a), p, p, rank_biserial(a - b), delta)
    ranks = average_ranks(np.concatenate([a, b]))  # keep values tied that differ only by rounding
    tied = len(np.unique(ranks)) < len(ranks)
    if np.ptp(ranks) == 0:
        p = 1.0
    else:
        method = "asymptotic" if tied or max(len(a), len(b)) >= 50 else "exact"  # as R's wilcox.test
        p = float(mannwhitneyu(ranks[: len(a)], ranks[len(a) :], method=method).pvalue)
    return Pair(effect, first, second, "Mann-Whitney", len(a) + len(b), p, p, None, delta)
