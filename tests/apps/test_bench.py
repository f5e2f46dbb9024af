"""``glsplat bench`` runs, and its numbers hang together."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from apps.cli import main
from glsplat.formats import save
from glsplat.splats import Level
from tests.apps.cli import mistake
from tests.scenes import cloud, limb

pytestmark = pytest.mark.gl


@pytest.mark.extra(name="evaluate")
def test_bench(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save(cloud(1024), tmp_path / "a.ply")
    assert main(["bench", str(tmp_path / "a.ply"), "--sizes", "32x24", "--frames", "3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {"driver", "machine", "cores", "date", "versions", "commit"} <= set(result)
    (row,) = result["settings"]
    assert row["kind"] == "static" and row["splats"] == 1024 and row["bytes_per_splat"] <= 120
    assert 0 < row["floor_ms"]["median"] and row["frame_ms"]["p95"] >= row["frame_ms"]["median"] > 0
    assert "skin" not in row["stages_ms"] and {"key", "sort", "project", "draw", "read"} <= set(row["stages_ms"])
    assert row["gpu_draw_ms"]["median"] >= 0


@pytest.mark.extra(name="evaluate")
def test_bench_of_an_avatar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    avatar = limb(200, joints=2)
    motion = tmp_path / "m.json"
    frames = [{"joints": {"joint1": [0, 0, 0.1 * i]}} for i in range(12)]
    motion.write_text(json.dumps({"fps": 30, "frames": frames}))
    save(avatar, tmp_path / "a.glb")
    arguments = ["bench", str(tmp_path / "a.glb"), "--motion", str(motion), "--sizes", "16", "--frames", "3"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "in motion, 2 x 16x16" in text and "skinning by joints a splat" in text and "frame / floor" in text
    assert "--frames: needs a whole number of at least 3" in mistake(capsys, *arguments[:-1], 2)


def leveled_file(folder: Path) -> str:
    """A cloud whose one level is another cloud, and whose cones hide half of it."""
    cones = np.tile(np.array([0, 0, 127, 0], np.int8), (900, 1))
    coarse = cloud(200, seed=5)
    save(replace(cloud(900), cones=cones, cones_psnr=50.0, levels=(Level(coarse, 5.0),)), folder / "a.glb")
    return str(folder / "a.glb")


@pytest.mark.extra(name="evaluate")
def test_what_a_frame_time_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", leveled_file(tmp_path), "--sizes", "64", "--frames", "4"]
    assert main([*words, "--budget", "10000", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["rows"]
    rows = {(row["level"], row["culled"], row["scale"]): row for row in found["rows"]}
    assert len(rows) == 2 * 2 + 4
    exact, coarse = rows[0, False, 1.0], rows[1, False, 1.0]
    assert exact["psnr"] == exact["psnr_box"] == 120 and found["chosen"] == exact  # there is time for everything
    assert coarse["psnr"] < 40 and coarse["psnr_box"] <= coarse["psnr"] and coarse["drawn"] < exact["drawn"]
    assert rows[0, True, 1.0]["drawn"] < exact["drawn"]
    assert main([*words, "--budget", "0.000001"]) == 0
    text = capsys.readouterr().out
    assert "nothing is that fast" in text and "left out" in text
    assert main([*words, "--budget", "5", "--level", "1"]) == 2
    assert "--budget tries all levels" in capsys.readouterr().err


@pytest.mark.extra(name="evaluate")
def test_where_the_time_goes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", leveled_file(tmp_path), "--sizes", "64", "32", "--frames", "3", "--profile"]
    assert main([*words, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [row["size"] for row in rows] == [[64, 64], [32, 32]] and rows[0]["frame_ms"] > 0
    stages = rows[0]["stages"]
    assert {"key", "sort", "project", "draw", "resolve", "read"} <= set(stages)
    assert stages["draw"]["gpu"] > 0 and all(stages[name]["waited"] > 0 for name in ("key", "project", "draw"))
    assert stages["sort"]["cpu"] > stages["sort"]["gpu"]  # numpy's
    assert main(words) == 0
    assert "whole frame" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main([*words, "--budget", "5"])
    assert "not allowed with" in capsys.readouterr().err
