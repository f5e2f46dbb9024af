"""The list of commands: grouped as the site is, and what ``glsplat`` alone says."""

from __future__ import annotations

import json
import multiprocessing
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from apps import cli, demo
from glsplat.errors import GlsplatError
from tests.apps.cli import parsed

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.extra(name="authoring")
def test_what_it_says_next_is_understood(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Alone it prints three command lines, each of which its command takes."""
    assert cli.main([]) == 0
    assert len(re.findall(r"(?m)^  glsplat (\w+)", capsys.readouterr().out)) == 3
    for line in re.findall(r"(?m)^  glsplat (.*?)  ", cli.NEXT):
        command, *words = line.split()
        module = cli.import_module(f"apps.{cli.MODULES.get(command, command)}")
        taken = []
        monkeypatch.setattr(module, "run", lambda args, taken=taken: taken.append(args) or 0)
        assert cli.main([command, *words]) == 0 and len(taken) == 1


def test_a_full_disk_is_one_line() -> None:
    code = "import sys; from apps.cli import main; sys.exit(main([]))"
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert done.returncode == 1 and done.stderr == "glsplat: No space left on device\n"


@pytest.mark.check
@pytest.mark.gl
def test_the_demo_measures_and_leaves_pictures_and_no_process(tmp_path, capsys):
    out = tmp_path / "out" / "demo"
    words = ["-o", out, "--seconds", 0.7, "--sizes", "96x96", "128x128", "--json"]
    assert demo.run(parsed(demo, *words)) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["runs"]) == ["96x96", "128x128"]
    for numbers in report["runs"].values():
        assert numbers["shown"] >= 1 and numbers["errors"] == 0 and numbers["stages_ms"]["render"]["median"] > 0
    assert sorted(p.name for p in out.iterdir()) == ["clip.mp4", "contact_sheet.png", "stages.txt"]
    assert (out / "stages.txt").read_text().count("end to end") == 2
    sheet = cv2.imread(str(out / "contact_sheet.png"))
    tiles = [sheet[100:600, 384 * i + 4 * i + 60 :][:, :260] for i in range(4)] + [sheet[300:1000, -600:-150]]
    for tile in tiles:  # a person fills part of each, before light grey
        person = tile.astype(int).max(axis=2) - tile.min(axis=2) > 30
        assert 0.2 < person.mean() < 0.95 and tile[~person].max() > 180
    assert not multiprocessing.active_children()


def test_a_server_that_cannot_start_is_one_line(tmp_path):
    with pytest.raises(GlsplatError, match=r"nowhere\.glb"):
        demo.run(parsed(demo, "-o", tmp_path, "--avatar", "nowhere.glb"))
    (tmp_path / "file").write_text("")
    with pytest.raises(GlsplatError, match="cannot make the folder"):
        demo.run(parsed(demo, "-o", tmp_path / "file"))
    assert not multiprocessing.active_children()
