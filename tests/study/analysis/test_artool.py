"""What R's ARTool says: a made-up study with its aligned values, and the results that ARTool's own tests hold on to."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from glsplat.study.analysis.align import aligned, ranked
from glsplat.study.analysis.anova import ModelName, art, art_contrasts, choose, name_of, stray
from glsplat.study.analysis.effect_sizes import partial_eta_squared
from glsplat.study.analysis.effects import effects_of
from glsplat.study.analysis.table import Table, read_table

pytestmark = pytest.mark.shared

FOUR_DIGITS = 5e-5


@pytest.fixture(scope="module")
def study(shared_data: Path) -> tuple[Table, dict[str, Any]]:
    folder = shared_data / "stats"
    said = json.loads((folder / "synthetic_2x3_within_n24.artool_expected.json").read_text())
    return read_table(folder / "synthetic_2x3_within_n24.csv", ["type", "method"], response="score"), said


def test_aligned_values_and_ranks(study: tuple[Table, dict[str, Any]]) -> None:
    table, said = study
    keys = {(0,): "type.1", (1,): "method.1", (0, 1): "type:method"}
    for effect in effects_of(2):
        for kind, ours, within in (("aligned", aligned(table, effect), 1e-9), ("ranked", ranked(table, effect), 0)):
            theirs = {(row["participant"], row["type"], row["method"]): row[keys[effect]] for row in said[kind]}
            for value, person, codes in zip(ours, table.participant, table.codes, strict=True):
                levels = (f.levels[c] for f, c in zip(table.factors, codes, strict=True))
                assert abs(value - theirs[(table.names[person], *levels)]) <= within


@pytest.mark.parametrize(("model", "key", "f"), [("rm", "anova_rm", "F value"), ("mixed", "anova_lmer", "F")])
def test_f_tests(study: tuple[Table, dict[str, Any]], model: ModelName, key: str, f: str) -> None:
    table, said = study
    tests = art(choose(table, model))
    assert [name_of(table, test.effect) for test in tests] == [row["Term"] for row in said[key]]
    for test, row in zip(tests, said[key], strict=True):
        ours = (test.f, test.df1, test.df2, test.p)
        assert ours == pytest.approx([row[f], row["Df"], row["Df.res"], row["Pr(>F)"]], rel=FOUR_DIGITS)
        if "eta.sq.part" in row:
            assert partial_eta_squared(*ours[:3]).value == pytest.approx(row["eta.sq.part"], rel=1e-8)
    assert choose(table).kind == "rm" and stray(choose(table)) == 0


# F and p as ARTool's test.anova.art.R has them, from the original ARTool; rounded to four places there
PUBLISHED = [
    ("Higgins1990Table5", "Tray", ("Moisture", "Fertilizer"), "DryMatter",
     [(3, 8, 23.8326, 0.0002), (3, 24, 122.4017, 0.0), (9, 24, 5.1180, 0.0006)]),
    ("HigginsABC", "Subject", ("A", "B", "C"), "Y",
     [(1, 4, 120.4706, 4e-4), (1, 4, 120.4706, 4e-4), (1, 4, 14.3217, 0.0194), (1, 4, 81.92, 8e-4),
      (1, 4, 0.1259, 0.7407), (1, 4, 0.2319, 0.6553), (1, 4, 0.9715, 0.3801)]),
]  # fmt: skip


@pytest.mark.parametrize(("name", "person", "factors", "response", "rows"), PUBLISHED)
def test_published(
    shared_data: Path, name: str, person: str, factors: tuple[str, ...], response: str, rows: list[tuple[float, ...]]
) -> None:
    table = read_table(shared_data / "stats" / f"{name}.csv", factors, participant=person, response=response)
    tests = art(choose(table))
    assert choose(table).kind == "rm"
    for test, (df1, df2, f, p) in zip(tests, rows, strict=True):
        assert (test.df1, test.df2) == (df1, df2) and round(test.f, 4) == f and round(test.p, 4) == p
    if name == "Higgins1990Table5":  # and by the mixed model, as that file has it, too
        for test, (df1, df2, f, _) in zip(art(choose(table, "mixed")), rows, strict=True):
            assert (test.df1, test.df2, test.f) == pytest.approx((df1, df2, f), rel=FOUR_DIGITS)


# t as ARTool's test.art.con.R has them, from the original ARTool and JMP
T_RATIOS = [
    ("Higgins1990Table5", "Tray", ("Moisture", "Fertilizer"), "DryMatter", "mixed", (0,),
     {0: -5.606839446, 1: -8.197725544, 2: -3.68391617, 3: -2.590886098, 4: 1.9229232756, 5: 4.5138093733}),
    ("Higgins1990Table5", "Tray", ("Moisture", "Fertilizer"), "DryMatter", "rm", (0, 1),
     {0: -1.107980814, 3: -3.036288461, 4: -5.007904345}),
    ("ElkinAB", "S", ("A", "B"), "Y", "rm", (0, 1), {0: -0.487275267, 1: -16.40493399, 2: -20.7904114}),
    ("ElkinABC", "S", ("A", "B", "C"), "Y", "mixed", (0, 1), {0: -0.072115146, 1: -14.74754746, 2: -10.13217808}),
    ("ElkinABC", "S", ("A", "B", "C"), "Y", "rm", (0, 1, 2), {0: -8.041788515, 2: -8.041788515, 6: -7.835588809}),
]  # fmt: skip


@pytest.mark.parametrize("row", T_RATIOS, ids=lambda row: f"{row[0]} {row[4]} {row[5]}")
def test_published_contrasts(shared_data: Path, row: tuple[Any, ...]) -> None:
    name, person, factors, response, model, effect, known = row
    table = read_table(shared_data / "stats" / f"{name}.csv", factors, participant=person, response=response)
    t = [row.t for row in art_contrasts(choose(table, model), effect)]
    assert {place: t[place] for place in known} == pytest.approx(known, rel=1e-5, abs=2e-6)
