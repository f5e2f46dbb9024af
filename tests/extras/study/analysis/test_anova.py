"""Alignment, repeated-measures F tests and the mixed model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from glsplat.errors import FormatError
from glsplat.extras.study.analysis.anova import (
    aligned,
    aligned_for_contrasts,
    art,
    art_contrasts,
    choose,
    ranked,
    spread_ranks,
    step_of,
)
from glsplat.extras.study.analysis.mixed import fit
from glsplat.extras.study.analysis.mixed import test as kenward_roger
from glsplat.extras.study.analysis.power import Planned
from glsplat.extras.study.analysis.repeated import contrast_rows, f_tests
from glsplat.extras.study.analysis.table import Table, effects_of, make_table

TABLE = Planned({"a": ("1", "2"), "b": ("1", "2", "3"), "c": ("1", "2")}, 7, frozenset({"c"})).table


def test_by_hand() -> None:
    """Two by two, two people: cells 1 3 / 2 6 with residuals of plus and minus one."""
    table = Planned({"a": ("1", "2"), "b": ("1", "2")}, 2).table
    y = np.array([0.0, 2, 1, 5, 2, 4, 3, 7])
    assert aligned(table, (0,), y).tolist() == [-2, -2, 0, 0, 0, 0, 2, 2]  # means of rows 2 and 4, grand 3
    assert aligned(table, (0, 1), y).tolist() == [-0.5, -1.5, -1.5, -0.5, 1.5, 0.5, 0.5, 1.5]
    assert ranked(table, (0,), y).tolist() == [1.5, 1.5, 4.5, 4.5, 4.5, 4.5, 7.5, 7.5]
    assert aligned_for_contrasts(table, (0, 1), y).tolist() == (y - 3).tolist()


def test_ranks_do_not_know_units_and_several_studies_are_ranked_at_once(rng: np.random.Generator) -> None:
    y, many = rng.integers(1, 8, len(TABLE.cell)).astype(float), rng.normal(size=(3, 2, len(TABLE.cell)))
    for effect in effects_of(3):
        expected = scipy.stats.rankdata(np.round(aligned(TABLE, effect, y), 9))
        for answers in (y, 1e-6 * y, y + 1e4):
            assert np.array_equal(ranked(TABLE, effect, answers), expected)
        one = [[ranked(TABLE, effect, y) for y in row] for row in many]
        assert np.array_equal(ranked(TABLE, effect, many), one)


def test_the_step_of_a_scale(rng: np.random.Generator) -> None:
    assert step_of(rng.integers(1, 8, 60).astype(float)) == 1
    assert step_of(rng.integers(4, 29, 90) / 4) == 0.25
    assert step_of(rng.normal(size=60)) is None and step_of(np.full(9, 2.0)) is None


def test_spread_ties(rng: np.random.Generator) -> None:
    """The same for the same seed; where there are no ties and a step is tiny, nothing changes."""
    y = rng.integers(1, 6, len(TABLE.cell)).astype(float)
    first = spread_ranks(TABLE, (0,), 1.0, y)
    assert np.array_equal(first, spread_ranks(TABLE, (0,), 1.0, y))
    assert not np.array_equal(first, spread_ranks(TABLE, (0,), 1.0, y, seed=1))
    assert first.sum() == pytest.approx(np.arange(1, len(y) + 1).sum())
    loose = rng.normal(size=len(y))
    assert np.array_equal(spread_ranks(TABLE, (0,), 1e-9, loose), ranked(TABLE, (0,), loose))


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


def gappy(seed: int, people: int = 9, spread: float = 1.0) -> Table:
    """2 between x 3 within, a fifth of the answers missing."""
    rng = np.random.default_rng(seed)
    table = Planned({"g": ("a", "b"), "w": ("x", "y", "z")}, people, frozenset({"g"})).table
    values = (
        rng.normal(size=len(table.cell)) + spread * rng.normal(size=people)[table.participant] + 0.4 * table.codes[:, 1]
    )
    kept = rng.random(len(values)) > 0.2
    return replace(table, participant=table.participant[kept], codes=table.codes[kept], values=values[kept])


def test_participants_who_do_not_differ() -> None:
    """A variance of 0 is a bound, and found exactly; shifting and scaling answers changes nothing."""
    fits = [fit(table, table.values) for table in (gappy(seed, spread=0.0) for seed in range(10, 22))]
    assert any(model is not None and model.intercepts == 0 for model in fits)
    table = gappy(4)
    found = [
        kenward_roger(table, (1,), fit(table, values))
        for values in (table.values, 1e5 + table.values, 1e6 * table.values)
    ]
    assert [test.f for test in found] == pytest.approx([found[0].f] * 3, rel=1e-5)


def test_nothing_that_varies() -> None:
    table = gappy(5)
    assert fit(table, np.ones(len(table.values))) is None
    assert fit(table, table.cell.astype(float)) is None  # cells explain all
    assert fit(table, 1000.0 * table.participant + 1e-9 * table.values) is None  # participants do
    assert np.isnan(kenward_roger(table, (1,), None).f)


def test_too_few_answers() -> None:
    single = Planned({"g": ("a", "b")}, 8, frozenset({"g"})).table
    with pytest.raises(FormatError, match="several answers"):
        fit(single, np.arange(8.0))
