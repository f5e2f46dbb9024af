"""Bootstrap intervals: scipy's, and how often they hold what they should."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from glsplat.statistics.bootstrap import interval_of_mean


def test_intervals_are_scipys(rng: np.random.Generator) -> None:
    sample = rng.gamma(1.5, 1, 24)  # skewed, so that percentiles alone would not do
    low, high = interval_of_mean(sample)
    scipys = scipy.stats.bootstrap((sample,), np.mean, n_resamples=50_000, method="BCa").confidence_interval
    width = scipys.high - scipys.low
    assert low == pytest.approx(scipys.low, abs=0.04 * width) and high == pytest.approx(scipys.high, abs=0.04 * width)
    percentile = scipy.stats.bootstrap((sample,), np.mean, n_resamples=50_000, method="percentile").confidence_interval
    assert high - percentile.high > 0.04 * width  # and the test can tell
    assert interval_of_mean(sample) == (low, high) != interval_of_mean(sample, seed=1)
    shifted = interval_of_mean(sample + 100)
    assert shifted == pytest.approx((low + 100, high + 100), abs=1e-9)


def test_intervals_cover_as_often_as_they_say(rng: np.random.Generator) -> None:
    hit = [low <= 0 <= high for low, high in (interval_of_mean(rng.normal(size=24)) for _ in range(300))]
    assert 0.88 < np.mean(hit) < 0.98
