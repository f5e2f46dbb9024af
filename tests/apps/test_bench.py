"""``glsplat bench`` runs, and its numbers hang together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from apps.cli import main
from glsplat.formats import save
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
    assert "in motion, 2 x 16x16" in text and "    skin " in text and "frame / floor" in text
    assert "--frames: needs a whole number of at least 3" in mistake(capsys, *arguments[:-1], 2)
