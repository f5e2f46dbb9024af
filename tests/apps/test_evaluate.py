"""glsplat evaluate: the folder it fills, what it says, what it refuses."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from apps.evaluate import command, plots
from glsplat import data
from glsplat.data import participants_folder
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.comparison import measure
from glsplat.extras.evaluate.comparison.work import work
from glsplat.extras.evaluate.lpips import Lpips
from tests.apps.cli import mistake
from tests.extras.evaluate.comparison.conftest import Pixels, plugged  # noqa: F401

QUICK = ["--views", "front", "--poses", "standing", "--size", "64", "--light", "none", "--jobs", "1", "--no-timing"]


@pytest.fixture(autouse=True)
def no_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither weights nor workers, which would not see what stands in for them; plots have tests of their own."""
    monkeypatch.setattr(plots, "png_of", lambda figure: b"\x89PNG")
    monkeypatch.setattr(measure, "flip", lambda one, other: float(np.abs(one - other).mean()))
    monkeypatch.setattr(measure, "_network", lambda kind: Pixels())
    monkeypatch.setattr(command, "Lpips", lambda kind: None)
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
    for text in ("Table 1, driven by the true pose", "What failed", "bob", "Methods in pairs", "By body part"):
        assert text in page
    assert main(words) == 1
    again = json.loads((out / "evaluation.json").read_text())
    assert "2 of 4 results lie in the folder already" in capsys.readouterr().out
    for key in ("table1", "views", "parts", "moments", "participants", "statistics", "failures"):
        assert first[key] == again[key], key


@pytest.mark.check
def test_participants_on_a_cluster(plugged, alone, tmp_path, capsys, monkeypatch) -> None:  # noqa: F811
    """As they come; one whose machine is lost is a failure like any other."""

    def on_ray(work, tasks, address):
        assert address == "gpu1:6379" and all(task.out.is_absolute() for task in tasks)
        yield 1, GlsplatError("its machine has ended")
        yield 0, work(tasks[0])

    monkeypatch.setattr(command, "on_ray", on_ray)
    plugged(itself="Itself")
    out = tmp_path / "out"
    assert main(["evaluate", *alone, "--methods", "itself", *QUICK, "--ray", "gpu1:6379", "-o", str(out)]) == 1
    found = json.loads((out / "evaluation.json").read_text())
    assert [(row["participant"], row["failed"]) for row in found["participants"] if "failed" in row] == [
        ("bob", "its machine has ended")
    ]
    assert found["table1"] and capsys.readouterr().out


@pytest.mark.check
def test_a_motion_and_further_measures(plugged, alone, tmp_path, capsys, monkeypatch) -> None:  # noqa: F811
    plugged(smaller="Smaller")
    walked = json.loads((Path(data.__file__).parent / "walk.json").read_text())
    motion, out = tmp_path / "mine.json", tmp_path / "out"
    motion.write_text(json.dumps(walked))
    words = ["evaluate", *alone, "--only", "ann", "--methods", "smaller", *QUICK, "-o", str(out)]
    words += ["--poses", str(motion), "--measure", "lpips-vgg,flip"]
    assert main(words) == 0
    found = json.loads((out / "evaluation.json").read_text())
    assert len({row["moment"] for row in found["moments"]}) == 8 and found["protocol"]["motion"] == str(motion)
    row = next(row for row in found["table1"] if row["control"] == "pose")
    assert row["flip"]["mean"] > 0 and row["lpips-vgg"]["mean"] > 0
    assert "FLIP" in (out / "evaluation.html").read_text()
    capsys.readouterr()
    assert main(words) == 0 and "1 of 1 results lie in the folder already" in capsys.readouterr().out
    motion.write_text(json.dumps({**walked, "frames": walked["frames"][5:]}))  # another motion under the same name
    assert main(words) == 0 and "already" not in capsys.readouterr().out
    assert json.loads((out / "evaluation.json").read_text())["table1"] != found["table1"]


def test_mistakes_are_one_line(plugged, alone, capsys) -> None:  # noqa: F811
    plugged(itself="Itself")
    for words, message in (
        ("--methods nobody", 'no method is called "nobody"'),
        ("--methods photo,photo", "--methods needs different names"),
        ("--methods x=/nowhere", "no such folder"),
        ("--methods photo=/", '"photo" is a method of its own'),
        ("--only zoe", "--only: no participant 'zoe'; there are ann, bob"),
        ("--poses standing,flying", "--poses: 'flying' is neither a motion nor one of"),
        ("--views above", "views are some of front"),
        ("--size 3", "64 to 2048"),
        ("--jobs 0", "--jobs: needs a whole number from 1 to 256"),
        ("--measure beauty", "further measures are flip"),
        ("--participants /nowhere", "/nowhere: no such folder"),
        ("-o /proc/nothing", "cannot make the folder"),
    ):
        assert message in mistake(capsys, "evaluate", *alone, "--methods", "itself", *QUICK, *words.split())


def test_what_is_missing_is_said_before_the_work(alone, capsys, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("GLSPLAT_MODELS", str(tmp_path / "none"))
    assert main(["evaluate", *alone, "--methods", "photo", *QUICK, "-o", str(tmp_path / "out")]) == 1
    assert "run: glsplat models get\n" in capsys.readouterr().err
    monkeypatch.setattr(command, "Lpips", Lpips)
    assert main(["evaluate", *alone, "--methods", "scan", *QUICK, "-o", str(tmp_path / "out")]) == 1
    assert "run: glsplat models get lpips\n" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
