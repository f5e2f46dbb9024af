"""Effect sizes: limits that give F its share, coverage, counting by hand."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from glsplat.study.analysis.effect_sizes import cliffs_delta, partial_eta_squared


def test_limits_of_eta_squared() -> None:
    """2.5 and 97.5 % of the noncentral F with these limits lie beyond F."""
    for f, df1, df2 in ((66.127, 1, 23), (7.5225, 2, 46), (90.64, 2, 46), (2.8, 3, 17.3), (400, 4, 200)):
        size = partial_eta_squared(f, df1, df2)
        assert size.value == pytest.approx(f * df1 / (f * df1 + df2))
        for limit, share in ((size.low, 0.975), (size.high, 0.025)):
            noncentrality = limit * (df1 + df2 + 1) / (1 - limit)
            known = scipy.stats.ncf(df1, df2, noncentrality) if noncentrality else scipy.stats.f(df1, df2)
            below = known.cdf(f)
            assert below == pytest.approx(share, abs=1e-6) or (limit == 0 and below < share)


def test_no_effect_and_no_error() -> None:
    none = partial_eta_squared(0.2, 2, 46)
    assert none.low == 0 < none.high < 0.1 and partial_eta_squared(0.0, 2, 46).value == 0
    assert partial_eta_squared(np.inf, 2, 46).value == 1 and np.isnan(partial_eta_squared(np.nan, 2, 46).value)


def test_delta_by_hand() -> None:
    """Of 3 x 4 pairs 7 are larger, 3 smaller and 2 tied."""
    first, second = np.array([2.0, 4, 5]), np.array([1.0, 2, 4, 4.5])
    assert cliffs_delta(first, second, paired=False).value == pytest.approx((1 + 2 + 4 - 2 - 1) / 12)
    apart = cliffs_delta(first + 9, second, paired=False)
    assert (apart.value, apart.low, apart.high) == (1, 1, 1)
    assert cliffs_delta(first, first, paired=True).value == 0 and np.isnan(
        cliffs_delta(first, first[:0], paired=False).low
    )
    assert cliffs_delta(np.array([0.1 + 0.2]), np.array([0.3]), paired=True).value == 0


def test_delta_of_the_same_people(rng: np.random.Generator) -> None:
    """Who is drawn is drawn with both answers: where they go together the interval is the narrower."""
    own = rng.normal(size=40)
    first, second = own + 0.3, own
    paired, apart = (cliffs_delta(first, second, paired=kind) for kind in (True, False))
    assert paired.value == apart.value and paired.high - paired.low < 0.6 * (apart.high - apart.low)
    assert paired == cliffs_delta(first, second, paired=True) != cliffs_delta(first, second, paired=True, seed=1)
