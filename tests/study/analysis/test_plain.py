"""Plain tests: scipy's where it does the same, R's figures, and everybody once a level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from glsplat.statistics.holm import holm
from glsplat.statistics.ranks import wilcoxon
from glsplat.study.analysis.plain import friedman, kruskal_wallis, plain_tests
from glsplat.study.analysis.power import Planned
from glsplat.study.analysis.table import make_table


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
