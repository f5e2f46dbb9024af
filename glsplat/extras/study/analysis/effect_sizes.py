"""Effect sizes with confidence intervals: partial eta squared of an F test, Cliff's delta of two conditions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import ncfdtr

from glsplat.arrays import F64
from glsplat.extras.statistics.bootstrap import LEVEL, RESAMPLES
from glsplat.extras.statistics.ranks import TIE


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
