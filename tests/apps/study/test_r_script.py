"""The script for R: models and error strata of each design. R ran it by hand, on a stand-in for ARTool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from apps.study.r_script import r_script
from glsplat.study.analysis.analysis import analyse
from glsplat.study.analysis.anova import ModelName
from glsplat.study.analysis.power import Planned

TWO, THREE = {"a": ("1", "2")}, {"b": ("x", "y", "z")}


def script(plan: Planned, model: ModelName = "auto") -> list[str]:
    table = replace(plan.table, values=np.random.default_rng(1).normal(size=len(plan.table.cell)))
    return r_script("t.csv", [analyse(table, model)], participant="who", response="y", long=True).splitlines()


@pytest.mark.parametrize(
    ("plan", "model", "whole", "pairs"),
    [
        (Planned(TWO | THREE, 6), "auto", " + Error(person / (a * b))", " + Error(person / (both))"),
        (Planned(TWO | THREE, 6), "mixed", " + (1 | person)", " + (1 | person)"),
        (Planned(TWO | THREE, 6, frozenset("a")), "auto", " + Error(person / (b))", " + (1 | person)"),
        (Planned(TWO | THREE, 12, frozenset("ab")), "auto", "", ""),
    ],
)
def test_error_strata(plan: Planned, model: ModelName, whole: str, pairs: str) -> None:
    lines = script(plan, model)
    assert f"m <- art(answer ~ a * b{whole}, data = d)" in lines
    assert f'print(art.con(art(answer ~ both{pairs}, data = d), "both", adjust = "holm"))' in lines
    assert 'd <- whole[whole[["measure"]] == "answer", ]' in lines and 'd$person <- factor(d[["who"]])' in lines


def test_three_factors() -> None:
    """Two of three: the third stays a factor, and a stratum where it is within."""
    lines = script(Planned(TWO | THREE | {"c": ("p", "q")}, 8, frozenset("c")))
    text = "\n".join(lines)
    assert "art(answer ~ both * c + Error(person / (both)), data = d)" in text
    assert "art(answer ~ both * b + (1 | person), data = d)" in text
    lines = script(Planned(TWO | THREE | {"c": ("p", "q")}, 8))
    assert "art(answer ~ both * b + Error(person / (both * b)), data = d)" in "\n".join(lines)


def test_groups_of_different_size_and_four_factors() -> None:
    assert any("type III (car's Anova)" in line for line in script(Planned(TWO | THREE, 7, frozenset("a")), "rm"))
    four = script(Planned(TWO | {"c": ("1", "2"), "d": ("1", "2"), "m": ("1", "2")}, 5))
    factors = "a * c * factor3 * factor4"
    assert f"m <- art(answer ~ {factors} + Error(person / ({factors})), data = d)" in four
    assert any("look at summary(m)" in line for line in four)
