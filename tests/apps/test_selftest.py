"""``glsplat selftest`` holds on this driver, names the smallest failing case, and outlives a driver that ends it."""

from __future__ import annotations

import json
import multiprocessing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apps.cli import main
from apps.selftest import command, parts
from glsplat.extras.evaluate.selftest import paths
from glsplat.extras.evaluate.selftest.driver import largest_scene
from glsplat.extras.evaluate.stability.frame import judge
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from tests.apps.cli import mistake

pytestmark = [pytest.mark.gl, pytest.mark.extra(name="evaluate")]


@pytest.mark.check
def test_every_scene_holds_on_a_fifth_of_the_paths(context: Context) -> None:
    cases = paths.contract_cases(context, quick=True)
    assert len(paths.contract_cases(context, quick=False)) == len(paths.SCENES) * len(paths.paths_of(context))
    drawn = {case.input.partition("; ")[2] for case in cases}
    assert drawn == {str(path) for path in paths.paths_of(context)} and {c.name for c in cases} == {
        scene.name for scene in paths.SCENES
    }
    assert [row for row in judge(cases, context) if row["verdict"] != "holds"] == []


class Faulty(Renderer):
    """A renderer that is wrong where ``fault`` makes it so."""

    fault = "blend"

    def render(self, views: Any, pose: Any = None, *, depth: bool = False) -> Any:
        image, far = super().render(views, pose, depth=True)
        if self.fault == "raises" and self.stats.drawn > 40:
            raise RuntimeError("the driver refuses")
        if self.fault == "blend":
            image[..., :3] *= 1.01
        if self.fault == "bytes" and depth:
            image[0, 0, 0, 0] = np.nextafter(image[0, 0, 0, 0], 1)
        return (image, far * (1.002 if self.fault == "depth" else 1)) if depth else image


@pytest.mark.parametrize(
    ("fault", "words", "fewest"),
    [("blend", "dB", 1), ("bytes", "not the bytes", 1), ("depth", "depth off by", 1), ("raises", "the driver", 64)],
)
def test_a_wrong_picture_is_found_and_reduced(
    context: Context, monkeypatch: pytest.MonkeyPatch, fault: str, words: str, fewest: int
) -> None:
    monkeypatch.setattr(paths, "Renderer", Faulty)
    monkeypatch.setattr(Faulty, "fault", fault)
    (row,) = judge(paths.contract_cases(context, quick=False)[:1], context)
    assert row["verdict"] == "failed" and words in row["seen"] and row["splats"] == fewest
    assert f"fails with {fewest} splats" in row["seen"]


@pytest.mark.check
def test_a_step_that_ends_the_process_fails_and_the_rest_goes_on() -> None:
    killed = []

    def show(label: str) -> None:
        if label.startswith("one scale zero") and not killed:
            killed.append(label)
            multiprocessing.active_children()[0].kill()

    rows = parts.run_part("hard", quick=True, device=None, show=show)["rows"]
    (failed,) = [row for row in rows if row["verdict"] == "failed"]
    assert failed["seen"] == "ended by SIGKILL" and len(rows) == 70 and rows[-1]["verdict"] == "holds"
    assert killed and len({row["case"] for row in rows}) == 70


def test_a_broken_promise_is_named_and_ends_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [parts._failed("hard", f"case {n}: given {n}", "wrong <b>") | {"splats": n} for n in (None, 8, 2, 4)]
    broken = {"seconds": 1.0, "rows": rows}
    monkeypatch.setattr(command, "run_part", lambda name, *_: broken if name == "hard" else broken | {"rows": []})
    words = ["selftest", "--parts", "hard", "goldens", "-o", str(tmp_path / "a" / "b")]
    assert main(words) == 1
    assert "smallest failing case: hard, case 2; given 2: wrong <b>" in capsys.readouterr().out
    result = json.loads((tmp_path / "a" / "b" / "selftest.json").read_text())
    assert list(result["parts"]) == ["hard", "goldens"] and not result["holds"]
    text = (tmp_path / "a" / "b" / "selftest.html").read_text()
    assert text.count('<tr class="failed">') == 4 and "wrong &lt;b&gt;" in text and "Not possible" in text
    broken["rows"] = []
    assert main(words) == 0


@pytest.mark.check
def test_measured_parts_are_written(tmp_path: Path) -> None:
    assert main(["selftest", "--quick", "--parts", "driver", "stream", "largest", "-o", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "selftest.json").read_text())
    (facts,) = result["parts"]["driver"]["rows"]
    assert facts["chosen"]["views"] == 2 and facts["memory"]["process"] > 1e6 and facts["limits"]
    assert result["parts"]["stream"]["rows"][0]["runs"] and result["parts"]["largest"]["rows"][0]["tried"]
    text = (tmp_path / "selftest.html").read_text()
    assert facts["driver"] in text and "pictures a second" in text and "72 Hz" in text


def test_the_largest_scene_is_between_what_keeps_the_rate_and_what_does_not(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    def linear(context: Context, subject: Any, frames: int) -> float:
        return len(subject.scene) / 1000

    monkeypatch.setattr("glsplat.extras.evaluate.selftest.driver.frame_ms", linear)
    found = largest_scene(context, hertz=72)  # 13,889 splats
    assert found["splats"] == 13_000 and [13_000, 13.0] in found["tried"] and [14_000, 14.0] in found["tried"]
    assert largest_scene(context, hertz=2000)["splats"] == 0


def test_mistakes_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert "choose from" in mistake(capsys, "selftest", "--parts", "drivers")
    assert "no EGL device 'nowhere'" in mistake(capsys, "selftest", "--device", "nowhere")
