"""glsplat evaluate: the folder it fills, what it says, what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from glsplat_apps.cli import main
from glsplat_apps.evaluate import command, ready

from glsplat.data import participants_folder
from glsplat.evaluate.comparison import measure
from glsplat.evaluate.comparison.work import work
from glsplat.evaluate.metrics.lpips import Lpips
from tests.evaluate.comparison.conftest import Pixels, plugged  # noqa: F401

QUICK = ["--views", "front", "--poses", "standing", "--size", "96", "--light", "none", "--jobs", "1", "--no-timing"]


@pytest.fixture(autouse=True)
def no_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither weights nor workers, which would not see what stands in for them."""
    monkeypatch.setattr(measure, "_network", lambda kind: Pixels())
    monkeypatch.setattr(ready, "Lpips", lambda kind: None)
    here = lambda tasks, jobs, show: [work(task, lambda *said: None) for task in tasks]  # noqa: E731
    monkeypatch.setattr(command, "run_tasks", here)


@pytest.fixture
def alone(tmp_path: Path) -> list[str]:
    """One participant and a broken one."""
    folder = tmp_path / "people"
    folder.mkdir()
    (folder / "ann.npz").write_bytes((participants_folder() / "p02.npz").read_bytes())
    (folder / "bob.npz").write_bytes(b"PK nothing")
    return ["--participants", str(folder)]


def test_a_folder_is_filled_and_a_second_run_changes_no_number(plugged, alone, tmp_path, capsys) -> None:  # noqa: F811
    plugged(itself="Itself", smaller="Smaller")
    out = tmp_path / "out"
    words = ["evaluate", *alone, "--methods", "itself,smaller", *QUICK, "-o", str(out)]
    assert main(words) == 1  # bob failed
    first = json.loads((out / "evaluation.json").read_text())
    said = capsys.readouterr()
    assert "1 of 2" in said.out and "failed: bob, itself" in said.out
    assert [row["participant"] for row in first["failures"]] == ["bob", "bob"]
    rows = {(row["method"], row["control"]): row for row in first["table1"]}
    assert rows["itself", "pose"]["l1"]["mean"] < rows["smaller", "pose"]["l1"]["mean"]
    page = (out / "evaluation.html").read_text()
    assert page.count("data:image/jpeg;base64,") == 2 and "http" not in re.sub(r"data:[^\"]+", "", page)
    for text in (
        "Table 1, driven by the true pose",
        "What failed",
        "bob",
        "1 of 2",
        "Methods in pairs",
        "By body part",
    ):
        assert text in page
    assert main(words) == 1
    again = json.loads((out / "evaluation.json").read_text())
    assert "2 of 4 results lie in the folder already" in capsys.readouterr().out
    for key in ("table1", "views", "parts", "moments", "participants", "statistics", "failures"):
        assert first[key] == again[key], key


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "nobody"], 'no method is called "nobody"'),
        (["--methods", "photo,photo"], "--methods needs different names"),
        (["--methods", "x=/nowhere"], "no such folder"),
        (["--methods", "photo=/"], '"photo" is a method of its own'),
        (["--methods", "x=/,x=/tmp"], "--methods needs different names"),
        (["--only", "zoe"], "--only: no participant 'zoe'; there are ann, bob"),
        (["--poses", "standing,flying"], "--poses: 'flying' is no motion and none of"),
        (["--poses", "flying"], "--poses: 'flying' is no motion and none of"),
        (["--views", "above"], "views are some of front"),
        (["--size", "3"], "64 to 2048"),
        (["--jobs", "0"], "--jobs needs 1 to 256"),
        (["--measure", "beauty"], "further measures are flip"),
        (["--participants", "/nowhere"], "/nowhere: no such folder"),
        (["-o", "/proc/nothing"], "cannot make the folder"),
    ],
)
def test_mistakes_are_one_line(plugged, alone, capsys, words, message) -> None:  # noqa: F811
    plugged(itself="Itself")
    base = ["evaluate", *alone, "--methods", "itself", *QUICK]
    assert main([*base, *words]) in (1, 2)
    said = capsys.readouterr()
    assert message in said.err and said.err.count("\n") == 1 and not said.out


def test_what_is_missing_is_said_before_the_work(alone, capsys, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path / "none"))
    assert main(["evaluate", *alone, "--methods", "photo", *QUICK, "-o", str(tmp_path / "out")]) == 1
    assert "run: glsplat models get\n" in capsys.readouterr().err
    monkeypatch.setattr(ready, "Lpips", Lpips)
    assert main(["evaluate", *alone, "--methods", "scan", *QUICK, "-o", str(tmp_path / "out")]) == 1
    assert "run: glsplat models get lpips\n" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
