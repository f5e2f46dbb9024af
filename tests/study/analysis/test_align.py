"""Alignment: what is left of other effects, ranks and their ties, and ties that are spread."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from glsplat.study.analysis.align import aligned, aligned_for_contrasts, ranked, spread_ranks, step_of
from glsplat.study.analysis.effects import effects_of
from glsplat.study.analysis.power import Planned

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
