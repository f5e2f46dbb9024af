"""Repeated-measures F tests: t tests in disguise, epsilon, several answers to one condition, what is degenerate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from glsplat.errors import FormatError
from glsplat.study.analysis.anova import art, art_contrasts, choose
from glsplat.study.analysis.power import Planned
from glsplat.study.analysis.repeated import contrast_rows, f_tests
from glsplat.study.analysis.table import Table, make_table


def with_values(plan: Planned, values: np.ndarray) -> Table:
    return replace(plan.table, values=values)


def test_two_levels_are_a_t_test(rng: np.random.Generator) -> None:
    within = with_values(Planned({"w": ("a", "b")}, 9), rng.normal(size=18))
    a, b = within.values[::2], within.values[1::2]
    f, df1, df2, p, _ = f_tests(within, (0,), within.values)
    t = scipy.stats.ttest_rel(a, b)
    assert (f, df1, df2, p) == pytest.approx((t.statistic**2, 1, 8, t.pvalue))
    estimate, se, df = contrast_rows(within, (0,), within.values, np.array([[1.0, -1]]))
    assert (estimate[0], df[0]) == pytest.approx(((a - b).mean(), 8)) and estimate[0] / se[0] == pytest.approx(
        t.statistic
    )
    between = with_values(Planned({"g": ("a", "b")}, 15, frozenset({"g"})), rng.normal(size=15))
    t = scipy.stats.ttest_ind(between.values[::2], between.values[1::2])
    f, _, df2, p, _ = f_tests(between, (0,), between.values)
    assert (f, df2, p) == pytest.approx((t.statistic**2, 13, t.pvalue))
    estimate, se, df = contrast_rows(between, (0,), between.values, np.array([[1.0, -1]]))
    assert estimate[0] / se[0] == pytest.approx(t.statistic) and df[0] == pytest.approx(13)


def test_epsilon() -> None:
    """Of answers that vary in one direction only it is 1 / (levels - 1), of equally correlated ones nearly 1."""
    plan = Planned({"w": ("a", "b", "c")}, 400)
    rng = np.random.default_rng(3)
    spherical = rng.normal(size=1200)
    assert f_tests(with_values(plan, spherical), (0,), spherical)[4] == pytest.approx(1, abs=0.02)
    line = (rng.normal(size=400)[:, None] * [-1.0, 0, 1]).ravel()
    assert f_tests(with_values(plan, line), (0,), line)[4] == pytest.approx(0.5)


def test_several_answers_to_one_condition(rng: np.random.Generator) -> None:
    """Ranks are of all answers; a participant's mean rank is tested."""
    rows = [(f"P{p}", (w,), float(v)) for p in range(8) for w in "ab" for v in rng.integers(1, 8, 3)]
    table = make_table("y", {"w": ("a", "b")}, rows)
    (test,) = art(choose(table))
    assert choose(table).kind == "rm" and test.df2 == 7
    ranks = scipy.stats.rankdata(np.round([row[2] for row in rows], 9))  # one factor: no other effect to align for
    means = ranks.reshape(8, 2, 3).mean(axis=2)
    assert test.f == pytest.approx(scipy.stats.ttest_rel(means[:, 0], means[:, 1]).statistic ** 2)


def test_what_is_degenerate() -> None:
    plan = Planned({"w": ("a", "b")}, 5)
    (same,) = art(choose(with_values(plan, np.full(10, 3.0))))
    assert (
        np.isnan(same.f) and np.isnan(same.p) and art_contrasts(choose(with_values(plan, np.full(10, 3.0))), (0,)) == []
    )
    (apart,) = art(choose(with_values(plan, np.tile([1.0, 2.0], 5))))
    assert apart.f == np.inf and apart.p == 0
    lonely = make_table("y", {"g": ("a", "b")}, [("p", ("a",), 1.0), ("q", ("b",), 2.0)])
    with pytest.raises(FormatError, match="more participants than groups"):
        choose(lonely)
    gaps = make_table("y", {"w": ("a", "b")}, [("p", ("a",), 1.0), ("p", ("b",), 1.0), ("q", ("b",), 2.0)])
    with pytest.raises(FormatError, match="two participants or more with every condition, found 1 of 2"):
        choose(gaps, "rm")
