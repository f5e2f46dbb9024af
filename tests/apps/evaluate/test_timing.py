"""Table 2 and the latency table of a comparison: real renderers; the server is another test's."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from apps.evaluate import plots, timing
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.comparison import measure
from glsplat.extras.evaluate.comparison.work import work
from glsplat.formats import save
from tests.extras.evaluate.comparison.conftest import Pixels
from tests.net.legacy.test_legacy import thinned

pytestmark = [pytest.mark.gl, pytest.mark.check]


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A quick run over two people; a method has an avatar of the second alone."""
    monkeypatch.setattr(measure, "_network", lambda kind: Pixels())
    monkeypatch.setattr(plots, "png_of", lambda figure: b"\x89PNG")
    monkeypatch.setattr(timing, "Lpips", lambda kind: Pixels())
    monkeypatch.setattr("apps.evaluate.command.Lpips", lambda kind: None)
    monkeypatch.setattr(
        "apps.evaluate.command.run_tasks", lambda tasks, jobs, show: [work(task, lambda *said: None) for task in tasks]
    )
    for name, people in (("both", ("p01", "p02")), ("second", ("p02",))):
        (tmp_path / name).mkdir()
        for one in people:
            save(thinned(default_avatar(), 200), tmp_path / name / f"{one}.glb")
    methods = ",".join(f"{name}={tmp_path / name}" for name in ("both", "second"))
    quick = ["--quick", "--only", "p01,p02", "--poses", "standing", "--views", "front", "--size", "64", "--jobs", "1"]
    return ["evaluate", "--methods", methods, *quick, "-o", str(tmp_path / "out")]


def streamed(quick: bool, avatar: Path | None = None) -> dict[str, object]:
    assert quick and avatar is not None and avatar.is_file()
    stage = {"median": 1.0, "p95": 2.0}
    names = ("ik", "communication", "wait", "render", "encode", "decode", "end_to_end")
    runs = [{"size": [512, 512], "stages": dict.fromkeys(names, stage), "beyond_render": stage, "age": stage}]
    return {"driver": "x", "fps": 72.0, "paper": {}, "runs": runs}


def test_who_has_most_avatars_is_timed(words, tmp_path, monkeypatch, capsys) -> None:
    seen = []
    monkeypatch.setattr(timing.latency, "measure", lambda quick, avatar: seen.append(avatar) or streamed(quick, avatar))
    monkeypatch.setattr(timing.latency, "rows", lambda found: [["stage", "median"], ["ik", "1.0"]])
    assert main(words) == 1  # p01 has no avatar by the second method
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())["timing"]
    assert found["participant"] == "p02" and [row["method"] for row in found["costs"]] == ["both", "second"]
    out = tmp_path / "out" / "avatars"
    assert seen == [out / "both" / "p02.glb", out / "second" / "p02.glb"]
    for row in found["costs"]:
        assert row["kind"] == "splats" and row["count"] == len(thinned(default_avatar(), 200).splats)
        assert row["size"] == 512 and row["pair_ms"] > 0 and row["two_ms"] > 0 and row["bytes"] > 1000
        assert np.isfinite(row["lpips"]) and row["lpips"] > 0 and row["paper"]["gain"] > 1
    assert found["costs"][0]["lpips"] == found["costs"][1]["lpips"]  # the same avatar
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "Table 2: rendering time and memory (p02)" in page and "Latency, second (ms)" in page
    assert "timing" not in capsys.readouterr().err

    def refused(quick: bool, avatar: Path) -> dict[str, object]:
        raise GlsplatError("no server started")

    monkeypatch.setattr(timing.latency, "measure", refused)  # which costs the timing alone
    assert main(words) == 1
    assert "no timing: no server started" in capsys.readouterr().err
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert found["timing"] == {} and found["table1"][0]["n"] == 2
