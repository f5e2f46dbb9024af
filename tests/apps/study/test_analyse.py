"""``glsplat study analyse``: a table in, a folder out; the words say what the numbers are; mistakes are one line."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.study import analyse, power
from apps.study.r_script import r_script
from apps.usage import UsageError
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.study.analysis.analysis import analyse as analysed
from glsplat.extras.study.analysis.anova import ModelName
from glsplat.extras.study.analysis.power import Planned
from tests.apps.cli import mistake, parsed

TYPES, METHODS = ("self", "other"), ("ours", "video", "image")


def table(
    folder: Path, *, gaps: bool = False, measures: Sequence[str] = ("presence", "agency"), people: int = 12
) -> Path:
    """An export as ``glsplat study export`` writes it: scores, answers to four items each, sidecars."""
    rng = np.random.default_rng(41)
    scores = ["participant,condition,type,method,position,measure,value"]
    answers = ["participant,step,position,condition,type,method,questionnaire,item,value,reversed,seconds"]
    for person, (place, (kind, method)), name in itertools.product(
        range(people), enumerate(itertools.product(TYPES, METHODS)), measures
    ):
        if gaps and (person, place) in ((0, 0), (3, 4)):
            continue
        mean = 4 + 0.9 * (kind == "self") + 0.7 * (method == "ours") + np.sin(person)
        items = np.clip(np.rint(mean + 0.8 * rng.normal(size=4)), 1, 7)
        key = f"P{person + 1:02},{kind}-{method},{kind},{method},{place + 1}"
        scores.append(f"{key},vr.{name},{items.mean()}")
        given = [*items[:3], 8 - items[3]]
        for i, value in enumerate(given):
            answers.append(
                f"P{person + 1:02},step{place},{place},c,{kind},{method},vr,{name}{i},{value:g},{int(i == 3)},2.5"
            )
    scores += [f"P{person + 1:02},,,,,vr.before,3" for person in range(people)]
    (folder / "scores.csv").write_text("\n".join(scores) + "\n")
    (folder / "answers.csv").write_text("\n".join(answers) + "\n")
    items_of = {f"vr.{name}": [f"vr.{name}{i}" for i in range(4)] for name in measures}
    study = {
        "factors": {
            "type": {"levels": list(TYPES), "kind": "within"},
            "method": {"levels": list(METHODS), "kind": "within"},
        },
        "measures": {
            name: {"items": items, "reversed": items[3:], "range": [1, 7]} for name, items in items_of.items()
        },
    }
    (folder / "scores.json").write_text(json.dumps({"value": {"Description": "score"}, "Study": study}))
    return folder / "scores.csv"


def test_an_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path)
    assert analyse.run(parsed(analyse, str(path), "-o", str(tmp_path / "results"))) == 0
    said = capsys.readouterr()
    assert "vr.presence: type, method at p < .05, 12 participants" in said.out and "vr.before: not asked" in said.err
    numbers = json.loads((tmp_path / "results" / "results.json").read_text())
    assert [response["response"] for response in numbers["responses"]] == ["vr.presence", "vr.agency"]
    first = numbers["responses"][0]
    assert first["model"] == "rm" and first["missing"] == 0 and first["stray_f"] == 0
    assert [factor["levels"] for factor in first["factors"]] == [list(TYPES), list(METHODS)]
    assert [cell["condition"] for cell in first["cells"]][:2] == ["self, ours", "self, video"]
    assert numbers["reliability"]["vr.agency"]["n"] == 72 and numbers["reliability"]["vr.agency"]["alpha"] > 0.6

    text = (tmp_path / "results" / "results.md").read_text()
    row = first["effects"][0]
    assert f"effect of type, F(1, 11) = {row['f']:.2f}, p < .001" in text and f"{row['f']:.4f}" in text
    pair = first["contrasts"][1]
    assert f"| {pair['first']} - {pair['second']} | {pair['estimate']:.4f} | {pair['se']:.4f} |" in text
    assert "Cronbach's alpha is ." in text and "McDonald's omega ." in text and "No answer is missing." in text
    assert "not over the 2 responses" in text

    image = cv2.imread(str(tmp_path / "results" / "boxplots.png"))
    assert image is not None and image.shape[1] > 700 and image.std() > 5
    script = (tmp_path / "results" / "analysis.R").read_text()
    assert "art(answer ~ type * method + Error(person / (type * method)), data = d)" in script
    assert 'd$type <- factor(d[["type"]], levels = c("self", "other"))' in script


def test_a_row_that_is_there_twice_and_a_coarse_scale_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, measures=["presence"])
    lines = path.read_text().splitlines()
    rounded = [line.rsplit(",", 1)[0] + f",{round(float(line.rsplit(',', 1)[1]))}" for line in lines[1:]]
    path.write_text("\n".join([lines[0], *rounded, rounded[0]]) + "\n")
    assert analyse.run(parsed(analyse, str(path), "--measure", "vr.presence")) == 0
    text = capsys.readouterr().out
    assert "1 answer is of a condition that the participant had answered before" in text
    assert "values only" in text and "with ties spread, F = " in text


@pytest.mark.check
def test_odd_answers(tmp_path: Path) -> None:
    """Nothing, or nothing else, varies; sizes that squares overflow on; names that no font and no table has."""
    names = ("=a\u4e2d", "b\u202e" + "x" * 500, "c`d")
    kinds: list[Callable[[int, int], float]] = [lambda p, w: 3, lambda p, w: p, lambda p, w: w]
    kinds += [lambda p, w: 1e99 * (p * w % 3), lambda p, w: 1e15 + (7 * p + w) % 5]
    for answer in kinds:
        rows = [f'P{p},"{name}",{answer(p, w)}' for p in range(6) for w, name in enumerate(names)]
        path = tmp_path / "odd.csv"
        path.write_text("participant,w,value\n" + "\n".join(rows) + "\n", encoding="utf-8")
        out = tmp_path / "out"
        assert analyse.run(parsed(analyse, path, "--factors", "w", "--model", "mixed", "-o", out)) == 0
        (response,) = json.loads((out / "results.json").read_text())["responses"]
        assert len(response["effects"]) == 1 and response["cells"][0]["n"] == 6
        assert "nan" not in (out / "results.md").read_text().replace("unknown", "")


def test_missing_answers_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path, gaps=True, measures=["presence"])
    assert analyse.run(parsed(analyse, str(path))) == 0
    text = capsys.readouterr().out
    assert "2 answers are missing; the mixed model uses all" in text and "linear mixed models" in text
    assert "without P01, P04, who lack a condition" in text and "The design is not balanced" in text
    assert analyse.run(parsed(analyse, str(path), "--model", "rm")) == 0
    text = capsys.readouterr().out
    assert "participants without every condition were left out (P01, P04)" in text and "F(1, 9)" in text


@pytest.mark.check
def test_wide_with_items(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A factor whose name R would not take, and levels that would break a table."""
    rng = np.random.default_rng(1)
    rows = [
        f"{p},{level},{','.join(map(str, rng.integers(1, 8, 3)))},{rng.normal():.3f}"
        for p in range(1, 10)
        for level in ("a|b", "c$d", '"e ""f"""')
    ]
    path = tmp_path / "wide.csv"
    path.write_text("who,my view,i1,i2,i3,time\n" + "\n".join(rows) + "\n")
    words = [str(path), "--participant", "who", "--factors", "my view", "--response", "time", "--items", "i1,i2,i3"]
    assert analyse.run(parsed(analyse, *words, "-o", str(tmp_path / "out"))) == 0
    text = (tmp_path / "out" / "results.md").read_text()
    assert "a\\|b" in text and "Of its 3 items (N = 27 complete rows)" in text
    script = (tmp_path / "out" / "analysis.R").read_text()
    assert 'd$factor1 <- factor(d[["my view"]], levels = c("a|b", "c$d", "e \\"f\\""))' in script
    assert "art(answer ~ factor1 + Error(person / (factor1)), data = d)" in script
    assert 'psych::alpha(sapply(whole[c("i1", "i2", "i3")], as.numeric))' in script


def test_mistakes(tmp_path: Path) -> None:
    path = table(tmp_path)
    for words, said in (
        ("--factors colour", "no column 'colour'"),
        ("--factors type,type", "each once"),
        ("--measure vr.none", "no row has the measure"),
        ("--response condition", "needs a number"),
        ("--participant who", "no column 'who'"),
        ("--items i1,i2", "no column 'i1'"),
    ):
        with pytest.raises(GlsplatError, match=said) as caught:
            analyse.run(parsed(analyse, path, *words.split()))
        assert "\n" not in str(caught.value)
    with pytest.raises(UsageError, match="this is a file"):
        analyse.run(parsed(analyse, str(path), "-o", str(path)))
    with pytest.raises(FormatError, match="there is no folder"):
        analyse.run(parsed(analyse, str(path), "-o", str(tmp_path / "no" / "where")))
    (tmp_path / "scores.json").unlink()
    with pytest.raises(UsageError, match=r"--factors is needed: there is no scores\.json"):
        analyse.run(parsed(analyse, str(path)))
    for wrong in ("{", '{"Study": 3}', '{"Study": {"factors": {"type": {"levels": "x"}}}}', "[" * 100_000):
        (tmp_path / "scores.json").write_text(wrong)
        with pytest.raises(GlsplatError, match=r"scores\.json"):
            analyse.run(parsed(analyse, str(path)))


FACTORS = ["--within", "type=self,other", "--within", "method=ours,video,image"]


def test_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    words = [*FACTORS, "--participants", "8", "24", "--effect", "type=0.6", "--runs", "200", "--seed", "3"]
    assert power.run(parsed(power, *words)) == 0
    first = capsys.readouterr().out
    assert "8 participants, 200 simulated studies, alpha 0.05:" in first and first.count("type:method") == 2
    power.run(parsed(power, *words, "--json"))
    rows = json.loads(capsys.readouterr().out)
    by = {(row["participants"], row["effect"]): row for row in rows}
    assert by[24, "type"]["power"] > by[8, "type"]["power"] + 0.1 > by[24, "method"]["power"] + 0.2
    assert f"power {by[24, 'type']['power']:.3f}" in first and by[8, "type"]["low"] < by[8, "type"]["power"]


def test_a_pilot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    rows = [f"{p},{w},{rng.normal() + 2 * (w == 'x'):.2f}" for p in range(8) for w in "xy"]
    (tmp_path / "pilot.csv").write_text("participant,w,value\n" + "\n".join(rows) + "\n")
    pilot = str(tmp_path / "pilot.csv")
    words = ["--pilot", pilot, "--factors", "w", "--participants", "20", "--runs", "100", "--json"]
    assert power.run(parsed(power, *words)) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["effect"] == "w" and row["power"] > 0.9
    with pytest.raises(UsageError, match="--factors is needed"):
        power.run(parsed(power, "--pilot", str(tmp_path / "pilot.csv"), "--participants", "20"))
    with pytest.raises(UsageError, match="leave out"):
        power.run(parsed(power, *words, "--effect", "w=1"))


def test_mistakes_of_a_plan(capsys: pytest.CaptureFixture[str]) -> None:
    both = " ".join(FACTORS)
    for words, said in (
        ("--participants 12", "name the factors"),
        (both, "--participants is needed"),
        (f"{both} --participants 12 --effect type", "--effect needs NAME=NUMBER"),
        (f"{both} --participants 12 --effect colour=1", "expected factors"),
        ("--within type=self --participants 12", "--within needs NAME=LEVEL,LEVEL"),
        (f"{both} --between type=a,b --participants 12", "--between needs"),
        (f"{both} --participants 12 --runs 0", "at least one run"),
        (f"{both} --participants 1", "2 participants or more"),
        (f"{both} --participants 12 --points 1", "2 to 1000 points"),
    ):
        assert said in mistake(capsys, "study", "power", *words.split())


TWO, THREE = {"a": ("1", "2")}, {"b": ("x", "y", "z")}


def script(plan: Planned, model: ModelName = "auto") -> list[str]:
    table = replace(plan.table, values=np.random.default_rng(1).normal(size=len(plan.table.cell)))
    return r_script("t.csv", [analysed(table, model)], participant="who", response="y", long=True).splitlines()


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


def test_groups_of_different_size_and_four_factors() -> None:
    assert any("type III (car's Anova)" in line for line in script(Planned(TWO | THREE, 7, frozenset("a")), "rm"))
    four = script(Planned(TWO | {"c": ("1", "2"), "d": ("1", "2"), "m": ("1", "2")}, 5))
    factors = "a * c * factor3 * factor4"
    assert f"m <- art(answer ~ {factors} + Error(person / ({factors})), data = d)" in four
    assert any("look at summary(m)" in line for line in four)
