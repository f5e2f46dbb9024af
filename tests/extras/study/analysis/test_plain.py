"""Plain tests, effect sizes and reliability, against scipy and R."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import holm, wilcoxon
from glsplat.extras.study.analysis.codebook import reliability
from glsplat.extras.study.analysis.plain import cliffs_delta, friedman, kruskal_wallis, partial_eta_squared, plain_tests
from glsplat.extras.study.analysis.power import Planned
from glsplat.extras.study.analysis.table import make_table


def test_friedman_is_scipys(rng: np.random.Generator) -> None:
    answers = rng.integers(1, 6, (14, 4)).astype(float)
    known = scipy.stats.friedmanchisquare(*answers.T)
    assert friedman(answers) == pytest.approx((known.statistic, 3, known.pvalue))
    assert friedman(np.ones((5, 3))) == (0, 2, 1)


def test_kruskal_as_r() -> None:
    """R: kruskal.test gives 5.09724 with p = 0.078189."""
    groups = [np.array([1.0, 2, 3, 3, 5]), np.array([2.0, 3, 4, 6, 4, 8]), np.array([7.0, 5, 6])]
    statistic, df, p = kruskal_wallis(groups)
    assert (round(statistic, 5), df, round(p, 6)) == (5.09724, 2, 0.078189)
    assert kruskal_wallis([np.ones(3), np.ones(4)]) == (0, 1, 1)


@pytest.mark.parametrize(
    ("a", "b", "p"),
    [  # R: wilcox.test, exact without ties, else normal with continuity correction
        ([1.1, 2.2, 3.3, 0.4, 5.1], [2.5, 3.1, 4.7, 6.2, 3.9, 8.8], 0.1255),
        ([1, 2, 3, 3, 5], [2, 3, 4, 6, 4, 8], 0.19504),
    ],
)
def test_groups_as_r(a: list[float], b: list[float], p: float) -> None:
    rows = [(f"{g}{i}", (g,), v) for g, values in (("a", a), ("b", b)) for i, v in enumerate(values)]
    (found,) = plain_tests(make_table("y", {"g": ("a", "b")}, rows))
    (pair,) = found.pairs
    assert pair.test == "Mann-Whitney" and pair.n == 11 and pair.rank_biserial is None
    assert pair.p == pytest.approx(p, abs=5e-5 if p == 0.1255 else 5e-6)


def test_within_factors(rng: np.random.Generator) -> None:
    """Means over the other factor; all six conditions once more together."""
    table = Planned({"a": ("1", "2"), "b": ("x", "y", "z")}, 10).table
    table = replace(table, values=rng.integers(1, 8, 60).astype(float))
    Y = table.values.reshape(10, 2, 3)
    first, second, both = plain_tests(table)
    assert [row.effect for row in (first, second, both)] == ["a", "b", "a:b"] and len(both.pairs) == 15
    assert first.pairs[0].p == wilcoxon(Y[:, 0].mean(axis=1) - Y[:, 1].mean(axis=1))
    known = scipy.stats.friedmanchisquare(*np.round(Y.mean(axis=1), 6).T)
    assert (second.statistic, second.p) == pytest.approx((known.statistic, known.pvalue))
    assert [pair.p_holm for pair in both.pairs] == holm([pair.p for pair in both.pairs])
    assert (both.pairs[0].first, both.pairs[-1].second) == ("1, x", "2, z")


def test_nothing_that_varies() -> None:
    table = Planned({"a": ("1", "2"), "g": ("x", "y")}, 8, frozenset({"g"})).table
    for row in plain_tests(table):
        assert row.p == 1 and all(pair.p == pair.p_holm == 1 and pair.delta.value == 0 for pair in row.pairs)


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


# made up; R 4.2.2: psych 2.2.9 alpha(x), factanal(x, 1, control = list(opt = list(factr = 1)))
ITEMS = np.array(
    [[5, 4, 5, 3], [3, 3, 2, 4], [6, 5, 6, 5], [2, 1, 3, 2], [4, 4, 5, 4], [7, 6, 6, 5], [3, 2, 4, 3],
     [5, 5, 4, 6], [6, 7, 5, 5], [1, 2, 2, 3], [4, 3, 4, 2], [5, 6, 6, 4], [2, 3, 1, 3], [6, 6, 7, 6]],
    float,
)  # fmt: skip


def test_as_r() -> None:
    found = reliability(ITEMS)
    assert (found.alpha, found.standardised) == pytest.approx((0.9256166056, 0.9271405286), rel=1e-9)
    assert (found.low, found.high) == pytest.approx((0.8320799, 0.9732836), rel=1e-6)
    assert found.omega == pytest.approx(0.93794626, rel=1e-5) and not found.at_bound
    assert (found.n, found.items, found.left_out) == (14, 4, 0)


def test_gaps_and_what_cannot_be_had() -> None:
    gaps = np.vstack([ITEMS, [np.nan, 1, 2, 3]])
    assert reliability(gaps).left_out == 1 and reliability(gaps).alpha == reliability(ITEMS).alpha
    assert reliability(ITEMS[:, :2]).omega is None and reliability(ITEMS[:, :2]).alpha is not None
    flat = reliability(np.column_stack([ITEMS[:, 0], np.full(14, 3.0)]))
    assert flat.alpha is None and flat.omega is None
    assert reliability(ITEMS[:, [0, 0, 1]]).at_bound  # an item twice
    for few in (ITEMS[:, :1], ITEMS[:2], np.full((5, 3), np.nan)):
        with pytest.raises(FormatError, match="two items and three complete rows"):
            reliability(few)
