"""Bootstrap intervals, Holm's correction and the signed-rank test, against R, scipy and counts by hand."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from glsplat.extras.statistics.nonparametric import average_ranks, holm, interval_of_mean, rank_biserial, wilcoxon


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


def test_intervals_of_few_and_of_equal_values() -> None:
    """Two values: a quarter of the samples has one of them twice. Values that rounding parts are one."""
    assert interval_of_mean(np.array([0.7, 0.1])) == pytest.approx((0.1, 0.7))
    assert interval_of_mean(np.array([1e9, 1e9 + 2e-7] * 3)) == pytest.approx((1e9, 1e9))
    assert interval_of_mean(np.array([0.5])) == (None, None)


def test_intervals_cover_as_often_as_they_say(rng: np.random.Generator) -> None:
    hit = [low <= 0 <= high for low, high in (interval_of_mean(rng.normal(size=24)) for _ in range(300))]
    assert 0.88 < np.mean(hit) < 0.98


def test_holm_as_published() -> None:
    """The values of R's p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm")."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.4, 0.9, 0.8]) == [1.0, 1.0, 1.0] and holm([]) == [] and holm([0.2]) == [0.2]


# Hollander and Wolfe (1973), p. 29: nine patients on the Hamilton scale; R's wilcox.test has it as its example
BEFORE = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
AFTER = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])


def counted(differences: np.ndarray) -> float:
    """The p of the signed-rank test by trying all signs."""
    some = differences[differences != 0]
    ranks = scipy.stats.rankdata(np.abs(some))
    sums = [np.dot(ranks, signs) for signs in itertools.product((0, 1), repeat=len(ranks))]
    plus = ranks[some > 0].sum()
    smaller = min(plus, ranks.sum() - plus)
    return min(1.0, 2 * np.mean(np.array(sums) <= smaller + 1e-9))


def test_wilcoxon_as_published() -> None:
    """R: V = 40, p-value = 0.01953 one-sided."""
    assert wilcoxon(BEFORE - AFTER) == pytest.approx(2 * 0.01953125, abs=1e-12)
    assert rank_biserial(BEFORE - AFTER) == pytest.approx((40 - 5) / 45)
    assert wilcoxon(AFTER - BEFORE) == wilcoxon(BEFORE - AFTER)


def test_wilcoxon_by_hand() -> None:
    """Six that all agree: 2 of the 64 signs are as extreme. With ties and zeros: every sign is tried."""
    assert wilcoxon(np.arange(1.0, 7)) == 2 / 64 and rank_biserial(np.arange(1.0, 7)) == 1
    assert wilcoxon(np.array([3.0, -1.0])) == 1 and rank_biserial(np.array([3.0, -1.0])) == pytest.approx(1 / 3)
    # Wikipedia's example: sums of ranks 27 and 18, a zero and two equal sizes
    tied = np.array([15.0, -7, 5, 20, 0, -9, 17, -12, 5, -10])
    assert wilcoxon(tied) == pytest.approx(counted(tied)) and rank_biserial(tied) == pytest.approx(9 / 45)
    for differences in ([1, 1, -1, 1], [2, 2, 2, -2, 5, 5, 0, 0], [1, 1, 1, 1, 1, -3, -3, 4, 4]):
        sample = np.array(differences, float)
        assert wilcoxon(sample) == pytest.approx(counted(sample), abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 5, 12, 24, 40])
def test_wilcoxon_is_scipys_where_no_sizes_are_equal(rng: np.random.Generator, n: int) -> None:
    for _ in range(5):
        differences = rng.normal(0.3, 1, n)
        expected = scipy.stats.wilcoxon(differences, method="exact").pvalue if n > 1 else 1.0
        assert wilcoxon(differences) == pytest.approx(expected, rel=1e-9)


def test_wilcoxon_of_many_is_near_the_normal_one(rng: np.random.Generator) -> None:
    differences = np.round(rng.normal(0.15, 1, 200), 1)  # many zeros and equal sizes
    z_based = scipy.stats.wilcoxon(differences[differences != 0]).pvalue
    assert wilcoxon(differences) == pytest.approx(z_based, abs=2e-3)


@pytest.mark.shared
def test_wilcoxon_of_ratings(shared_data: Path) -> None:
    """24 raters, whole-number scores: nearly all are tied; a million random signs agree."""
    table = np.genfromtxt(
        shared_data / "stats" / "synthetic_2x3_within_n24.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    first, second = (table[(table["type"] == "self") & (table["method"] == m)]["score"] for m in ("ours", "video"))
    differences = first - second
    assert len(differences) == 24 and len(np.unique(np.abs(differences))) < 20
    ranks = scipy.stats.rankdata(np.abs(differences[differences != 0]))
    plus = ranks[differences[differences != 0] > 0].sum()
    sums = (np.random.default_rng(1).random((1_000_000, len(ranks))) < 0.5) @ ranks
    expected = 2 * (sums <= min(plus, ranks.sum() - plus)).mean()
    assert wilcoxon(differences) == pytest.approx(expected, abs=4 * math.sqrt(expected / 1e6) + 1e-6)


def test_ranks_are_scipys(rng: np.random.Generator) -> None:
    many = rng.integers(0, 9, (7, 3, 50)) / 4 - 1
    assert np.array_equal(average_ranks(many), scipy.stats.rankdata(many, axis=-1))
    assert average_ranks(np.zeros(4)).tolist() == [2.5] * 4 and average_ranks(np.zeros((2, 0))).shape == (2, 0)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e9])
def test_what_rounding_parts_is_a_tie(scale: float) -> None:
    """0.1 + 0.2 is 0.3, whatever the unit; what differs in the eighth digit does differ."""
    assert average_ranks(scale * np.array([0.3, 0.1 + 0.2, 1.0, 0.30000003])).tolist() == [1.5, 1.5, 4, 3]
    assert wilcoxon(scale * np.array([0.3, -(0.1 + 0.2), 1e-17])) == 1
