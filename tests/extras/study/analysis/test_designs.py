"""Two hundred made-up studies: none crashes, and where R has a figure, ours is R's (tools/study/r_figures.py)."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from apps.study.r_script import r_script
from apps.study.results_text import results_text
from glsplat.errors import FormatError
from glsplat.extras.study.analysis.analysis import analyse
from glsplat.extras.study.analysis.anova import (
    Model,
    ModelName,
    art,
    art_contrasts,
    choose,
    name_of,
    ranked_for_contrasts,
)
from glsplat.extras.study.analysis.mixed import fit
from tests.extras.study.analysis.designs import COUNT, design

SAID: dict[str, dict[str, dict[str, list[float]]]] = json.loads(
    (Path(__file__).parent / "data" / "r_figures.json").read_text()
)
FOUR_DIGITS = 5e-5


@pytest.mark.check
def test_no_study_crashes() -> None:
    """Every 50th by all models with words, numbers and script; refusals are one line, and few."""
    refused = []
    for number in range(3, COUNT, 50):
        table = design(number).table()
        for kind in ("auto", "rm", "mixed"):
            try:
                result = analyse(table, kind)  # type: ignore[arg-type]
            except FormatError as error:
                assert "\n" not in str(error)
                refused.append((number, kind))
                continue
            assert len(result.effects) == 2 ** len(table.factors) - 1
            assert all(row.f >= 0 and 0 <= row.p <= 1 and row.df2 > 0 for row in result.effects)
            assert all(0 <= row.eta_squared.low <= row.eta_squared.value <= 1 for row in result.effects)
            assert all(row.p <= row.p_holm <= 1 and row.se > 0 for row in result.contrasts)
            json.dumps(result.to_json(), allow_nan=False)
            assert "nan" not in results_text([result])
            assert "art(answer ~ " in r_script("t.csv", [result], participant="p", response="y", long=False)
    one_each = [n for n in range(3, COUNT, 50) if not design(n).table().within]
    assert {(number, "mixed") for number in one_each} <= set(refused)  # a random intercept needs several answers
    assert all(kind != "auto" for _, kind in refused)


def numbers(model: Model, kind: str) -> dict[str, list[float]]:
    if kind in ("rm", "mixed"):
        return {name_of(model.table, test.effect): [test.f, test.df1, test.df2, test.p] for test in art(model)}
    effects = [(0,), (0, 1)]
    rows = {name_of(model.table, effect): art_contrasts(model, effect)[:3] for effect in effects}
    return {name: [x for c in own for x in (c.estimate, c.se, c.df, c.t)] for name, own in rows.items()}


def compare(kind: str, step: int) -> int:
    """Every ``step``-th study by that model against R; how many effects were compared."""
    compared, model_name = 0, kind.split("_")[0]
    for number, kinds in list(SAID.items())[::step]:
        if not kinds[kind]:
            continue
        ours = numbers(choose(design(int(number)).table(), model_name), kind)  # type: ignore[arg-type]
        for effect, theirs in kinds[kind].items():
            # of contrasts t may be a difference of 0: compare it by the size of an ordinary t
            assert ours[effect] == pytest.approx(theirs, rel=FOUR_DIGITS, abs=1e-5), (number, effect)
            compared += 1
    return compared


@pytest.mark.check
@pytest.mark.parametrize(
    ("kind", "least"), [("rm", 370), ("mixed", 500), ("rm_contrasts", 60), ("mixed_contrasts", 110)]
)
def test_where_r_has_a_figure(kind: str, least: int) -> None:
    assert compare(kind, 2) >= least


def test_where_r_has_a_figure_in_short() -> None:
    for kind in ("rm", "mixed", "rm_contrasts", "mixed_contrasts"):
        assert compare(kind, 30) >= 4


def test_a_choice_of_models() -> None:
    names: list[ModelName] = ["rm", "mixed"]
    gaps = next(table for n in range(COUNT) if (table := design(n).table()).incomplete and len(table.names) > 12)
    assert choose(gaps).kind == "mixed" and choose(gaps).left_out == ()
    assert choose(gaps, "rm").left_out == gaps.incomplete and len(choose(gaps, "rm").table.names) == len(
        gaps.names
    ) - len(gaps.incomplete)
    assert [choose(gaps, name).kind for name in names] == names


@pytest.mark.check
def test_contrasts_across_strata() -> None:
    """One factor within, one between, balanced: strata and Satterthwaite are the mixed model, where people differ."""
    compared = 0
    for number, kinds in SAID.items():
        table = design(int(number)).table()
        if len(table.factors) > 2 or not table.balanced or not table.within or not table.between:
            continue
        rows = ranked_for_contrasts(table, (0, 1))
        fitted = fit(table, rows)
        assert fitted is not None
        if fitted.intercepts > 0:
            ours = numbers(choose(table, "rm"), "rm_contrasts")["A:B"]
            assert ours == pytest.approx(kinds["mixed_contrasts"]["A:B"], rel=FOUR_DIGITS, abs=1e-5), number
            compared += 1
    assert compared >= 4
