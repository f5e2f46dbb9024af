"""Power by simulation: theory where there is one, type I error, pilots, and one line for what makes no plan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.stats

from glsplat.errors import FormatError
from glsplat.extras.study.analysis.power import Planned, from_pilot, power

TYPE, METHOD = {"type": ("self", "other")}, {"method": ("ours", "video", "image")}


def test_power_is_theorys() -> None:
    """Ranks of normal answers lose little against the t test, whose power the noncentral t has."""
    plan = Planned(TYPE, 24, correlation=0.5)
    (row,) = power(plan.draws({"type": (0.6,)}), plan.table, runs=2000, seed=5)
    critical = scipy.stats.t.ppf(0.975, 23)
    noncentral = 0.6 / np.sqrt(2 * 0.5 / 24)  # differences have variance 2 (1 - 0.5)
    theory = 1 - scipy.stats.nct.cdf(critical, 23, noncentral)
    assert theory - 0.06 < row.power < theory + 0.02 and row.low < row.power < row.high


@pytest.mark.check
@pytest.mark.parametrize(
    ("plan", "step"),
    [
        (Planned(TYPE | METHOD, 24), None),
        (Planned(TYPE | METHOD, 23, frozenset({"type"}), correlation=0.2), None),
        (Planned(METHOD, 20, points=7), 1.0),
    ],
)
def test_type_one_error(plan: Planned, step: float | None) -> None:
    """4 to 6 % of 4,000 studies without effects; on rating scales with ties spread."""
    for row in power(plan.draws({}), plan.table, runs=4000, seed=11, step=step):
        assert 0.04 <= row.power <= 0.06, row


def test_the_same_seed() -> None:
    plan = Planned(TYPE, 10, points=5)
    told: list[int] = []
    rows = power(plan.draws({"type": (0.5,)}), plan.table, runs=250, seed=1, progress=told.append)
    assert rows == power(plan.draws({"type": (0.5,)}), plan.table, runs=250, seed=1) and sum(told) == 250
    assert rows != power(plan.draws({"type": (0.5,)}), plan.table, runs=250, seed=2)


def test_means_of_conditions() -> None:
    plan = Planned(TYPE | METHOD, 6)
    assert plan.means({"method": (0.6,)}).tolist() == [[-0.3, 0, 0.3]] * 2
    assert plan.means({"type": (1, 0)}) == pytest.approx(np.array([[0.5] * 3, [-0.5] * 3]))
    product = plan.means({"type:method": (1.0,)})
    assert product == pytest.approx(np.array([[0.5, 0, -0.5], [-0.5, 0, 0.5]]))
    assert plan.means({"method:type": (1.0,)}) == pytest.approx(product)
    pure = plan.means({"type:method": (1, 0, 0, 0, 0, 0)})
    assert [*pure.sum(axis=0), *pure.sum(axis=1), pure[0, 0]] == pytest.approx([0, 0, 0, 0, 0, 1 / 3])
    assert plan.means({"type": (1.0,), "method": (0.6,)}).max() == pytest.approx(0.8)


def test_a_rating_scale() -> None:
    answers = Planned(TYPE, 30, points=7).draws({"type": (1.0,)})(np.random.default_rng(0), 40)
    assert set(np.unique(answers)) <= set(range(1, 8)) and answers.mean() == pytest.approx(4, abs=0.1)
    assert answers[:, 1::2].mean() - answers[:, ::2].mean() == pytest.approx(1.5, abs=0.15)


def test_a_pilot() -> None:
    """Everybody drawn is one of the pilot's, whole, and stays in the group."""
    plan = Planned(METHOD | {"g": ("a", "b")}, 8, frozenset({"g"}))
    pilot = replace(plan.table, values=np.arange(24.0))
    draws, table = from_pilot(pilot, 11)
    answers = draws(np.random.default_rng(0), 50).reshape(50, 11, 3)
    assert len(table.names) == 11 and (np.diff(answers, axis=2) == 1).all()
    who = answers[:, :, 0] / 3
    assert (who % 2 == table.group).all() and len(np.unique(who)) == 8
    rows = power(draws, table, runs=50)
    assert [row.effect for row in rows] == ["method", "g", "method:g"]


def test_no_plan_no_effect_no_runs() -> None:
    mistakes: list[tuple[dict[str, Any], str]] = [
        ({"participants": 1}, "1 groups need 2 participants or more, not 1"),
        ({"participants": 3, "between": frozenset({"type"})}, "2 groups need 4"),
        ({"between": frozenset({"colour"})}, "no factor is named 'colour'"),
        ({"correlation": 1.0}, "correlation needs 0 or more"),
        ({"points": 1}, "2 to 1000 points"),
        ({"participants": 9999}, "at most 20000 answers"),
    ]
    for mistake, said in mistakes:
        with pytest.raises(FormatError, match=said):
            Planned(**({"factors": TYPE | METHOD, "participants": 12} | mistake))
    for effects in ({"colour": (1.0,)}, {"type:type": (1.0,)}, {"method": (1, 2)}, {"type": (np.nan,)}, {"": (1.0,)}):
        with pytest.raises(FormatError, match="effect"):
            Planned(TYPE | METHOD, 12).means(effects)
    plan = Planned(TYPE, 4)
    for wrong in ({"runs": 0}, {"alpha": 0.0}, {"alpha": 1.0}):
        with pytest.raises(FormatError, match="at least one run"):
            power(plan.draws({}), plan.table, **wrong)  # type: ignore[arg-type]
