"""The mixed model where participants or answers do not vary; test_designs.py holds its figures to those of R."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.study.analysis.mixed import fit
from glsplat.study.analysis.mixed import test as kenward_roger
from glsplat.study.analysis.power import Planned
from glsplat.study.analysis.table import Table


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
