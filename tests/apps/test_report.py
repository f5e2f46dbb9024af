"""``glsplat report`` writes what it measured, and a case that does not hold shows as failed."""

from __future__ import annotations

import gc
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from apps.report import command as report
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate import subjects as report_subjects
from glsplat.extras.evaluate.costs import features_of, left_out
from glsplat.extras.evaluate.stability import frame as report_stability
from glsplat.extras.evaluate.stability.extremes import all_cases
from glsplat.extras.evaluate.stability.frame import Case, Outcome, camera, frame_cases, judge, picture_case
from glsplat.extras.evaluate.subjects import Subject
from glsplat.formats import save
from glsplat.gl.context import Context
from tests.scenes import cloud, limb, one_splat
from tools.docs import measured

pytest.importorskip("flip_evaluator")
pytest.importorskip("matplotlib")
pytestmark = pytest.mark.gl


@pytest.fixture(autouse=True)
def frozen() -> Iterator[None]:
    """What other tests left is not looked through each time that buffers are counted."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


# ------------------------------------------------------------------------------------------------------- stability


@pytest.mark.check
def test_every_hard_case_holds(context: Context) -> None:
    rows = judge(all_cases(), context)
    assert [r for r in rows if r["verdict"] != "holds"] == []
    assert len(rows) >= 105 and len({r["case"] for r in rows}) == len(rows)
    assert all(r["input"] and r["behaviour"] for r in rows)


def test_the_page_of_hard_cases_has_them_all() -> None:
    """The columns that do not depend on the driver; `python -m tools.docs.measured hard` writes it anew."""
    lines = [line for line in measured.tables("hard")["cases"].splitlines()[2:]]
    shown = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    cases = [{"group": c.group, "case": c.name, "input": c.input, "behaviour": c.behaviour} for c in all_cases()]
    assert [row[:4] for row in shown] == [measured.hard_cells(case) for case in cases]
    assert all(row[5] == "holds" for row in shown)


def test_a_case_that_does_not_behave_as_stated_fails(context: Context) -> None:
    """Wrong picture, wrong reason, drawn but should not be, accepted but should be refused, an exception."""
    shifted = one_splat(means=[[0.1, 0, 0]])
    visible, hidden = one_splat(), one_splat(opacities=[0.0])

    def breaks(_: Context) -> Outcome:
        raise RuntimeError("the driver is gone")

    def case(check: Callable[[Context], Outcome]) -> Case:
        return Case("g", "n", "i", "b", check)

    rows = judge(
        [
            picture_case("shifted", "i", "b", shifted, [camera()], expected=visible),
            case(report_stability._counted(hidden, "outside")),
            case(report_stability._counted(visible, "transparent")),
            case(report_stability.refused(GlsplatError, "never", lambda: None)),
            case(breaks),
            picture_case("right", "i", "b", visible, [camera()]),
        ],
        context,
    )
    assert [r["verdict"] for r in rows] == ["failed"] * 5 + ["holds"]
    assert rows[0]["error"] > 0.06
    assert rows[1]["seen"] == "transparent" and rows[2]["seen"] == "drawn" and rows[3]["seen"] == "accepted"
    assert rows[4]["seen"] == "RuntimeError: the driver is gone"


# ------------------------------------------------------------------------------------------------ what is left out


@pytest.mark.check
def test_pictures_that_differ_are_not_called_one(context: Context) -> None:
    subject = Subject("cloud", cloud(150), 32)
    (feature, *_) = features_of(subject.scene, context)
    wrong = replace(feature, full=(cloud(150, seed=1), feature.full[1]))
    (row,) = left_out(context, subject, [wrong], 3)
    assert not row["same_picture"] and row["apart"] > 0.1


# ------------------------------------------------------------------------------------------------------- the files


def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """All features that can be left out take longer than a test may."""
    monkeypatch.setattr(report, "features_of", lambda *given: features_of(*given)[:2])


@pytest.mark.check
def test_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One command, a scene with a camera of another folder: everything that it should say is in the JSON.

    The page needs nothing else, JSON holds no infinity, and a failed case cannot be missed.
    """
    short(monkeypatch)
    monkeypatch.setattr(report_subjects, "default_avatar", lambda: limb(120))

    def bad(_: Context) -> Outcome:
        return Outcome(False, np.inf, seen="<script>")

    cases = [*frame_cases()[:4], Case("g", "bad <b>", "i", "b", bad)]
    monkeypatch.setattr(report, "all_cases", lambda: cases)
    save(cloud(80), tmp_path / "a.ply")
    view, out = tmp_path / "view.json", tmp_path / "out"
    view.write_text(json.dumps(camera(40).to_json()))
    words = ["report", str(tmp_path / "a.ply"), "--cameras", f"a={view}", "--quick", "--frames", "3", "--size", "32"]
    main([*words, "-o", str(out)])
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == str(out / "report.html")
    result = json.loads((out / "report.json").read_text())
    scenes = ["default avatar, static", "default avatar, its joints swaying", "a.ply"]
    assert [s["scene"] for s in result["scenes"]] == scenes and [s["views"] for s in result["scenes"]] == [2, 2, 1]
    assert [s["size"] for s in result["scenes"]] == [[32, 32]] * 3
    assert result["driver"] and result["machine"] and result["cores"] >= 1 and result["date"] >= "2026"
    assert {"glsplat", "python", "numpy", "moderngl", "matplotlib", "flip-evaluator"} <= set(result["versions"])
    text = (out / "report.html").read_text()
    (failed,) = [row for row in result["stability"] if row["verdict"] == "failed"]
    assert failed["error"] is None and result["scenes"][0]["rows"][0]["cpu_ms"] > 0
    assert set(result["quiet"]) == {"others", "noise"} and "4. What to use on" in text and "glsplat render" in text
    assert text.count('<tr class="failed">') == 1 and "&lt;script&gt;" in text and "bad &lt;b&gt;" in text
    assert not re.findall(r'(?:src|href)="(?!data:)', text) and "http" not in re.sub(r"data:[^\"]+", "", text)
    assert text.count("data:image/png;base64,") == len(list(out.glob("*.png"))) == 4
