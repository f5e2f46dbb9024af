"""The demo as a user runs it, small and short."""

from __future__ import annotations

import json
import multiprocessing

import cv2
import pytest

from apps import demo
from glsplat.errors import GlsplatError
from tests.apps.cli import parsed


@pytest.mark.check
@pytest.mark.gl
def test_the_demo_measures_and_leaves_pictures_and_no_process(tmp_path, capsys):
    out, table = tmp_path / "out" / "demo", tmp_path / "performance.md"
    words = ["-o", out, "--seconds", 0.7, "--sizes", "96x96", "128x128", "--table", table, "--json"]
    assert demo.run(parsed(demo, *words)) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["runs"]) == ["96x96", "128x128"]
    for numbers in report["runs"].values():
        assert numbers["shown"] >= 1 and numbers["errors"] == 0 and numbers["stages_ms"]["render"]["median"] > 0
    assert sorted(p.name for p in out.iterdir()) == ["clip.mp4", "contact_sheet.png"]
    sheet = cv2.imread(str(out / "contact_sheet.png"))
    assert sheet.shape[1] == 2 * 256 + 4 and sheet.max() > 100
    assert "96x96: median | p95 | 128x128: median" in table.read_text()
    assert not multiprocessing.active_children()


def test_a_server_that_cannot_start_is_one_line(tmp_path):
    with pytest.raises(GlsplatError, match=r"nowhere\.glb"):
        demo.run(parsed(demo, "-o", tmp_path, "--avatar", "nowhere.glb"))
    (tmp_path / "file").write_text("")
    with pytest.raises(GlsplatError, match="cannot make the folder"):
        demo.run(parsed(demo, "-o", tmp_path / "file"))
    assert not multiprocessing.active_children()
