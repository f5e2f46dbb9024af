"""docs/examples: each program runs and draws what it says."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps.demo import running_server
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.formats import load, save
from tests.needs import program, require
from tests.scene.people import boxes, save_person
from tests.scenes import limb
from tests.skinning.avatars import part

ROOT = Path(__file__).resolve().parents[1]
CLIENT = ROOT / "docs" / "examples" / "client.mjs"
PROGRAMS = sorted((ROOT / "docs" / "examples").glob("*.py"))

pytestmark = [pytest.mark.gl, pytest.mark.check]

Run = Callable[..., str]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs one of them as a user does, in an empty folder; what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(ROOT / "docs" / "examples" / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_each_is_linked_from_the_gallery() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert PROGRAMS and all(f"(examples/{one.name})" in page for one in PROGRAMS)


def test_one_picture(run: Run, tmp_path: Path) -> None:
    save(part(default_avatar(), np.arange(0, 40000, 2)), tmp_path / "me.glb")
    assert "the avatar covers" in run("one_picture.py", "out.png", "me.glb")
    picture = cv2.imread("out.png", cv2.IMREAD_UNCHANGED)
    assert picture.shape == (640, 480, 4) and 0.05 < (picture[..., 3] > 127).mean() < 0.5


def test_stereo_pair(run: Run) -> None:
    said = run("stereo_pair.py")
    assert "eyes 63 mm apart" in said
    left, right = np.split(cv2.imread("pair.png"), 2, axis=1)
    assert (left != right).any() and all(0.02 < figure(eye) < 0.5 for eye in (left, right))


def test_two_people(run: Run) -> None:
    said = run("two_people.py")
    assert "3 items" in said
    picture = cv2.imread("people.png")
    assert picture.shape == (480, 640, 3) and (picture.max(axis=2) > 20).mean() > 0.7
    # both are there: each half differs from the bare wall
    assert all(half.std() > 20 for half in np.split(picture, 2, axis=1))


@pytest.fixture
def url() -> Iterator[str]:
    """A server of the default avatar."""
    with running_server(None, RenderConfig()) as address:
        yield address


def test_drive_a_server(run: Run, url: str) -> None:
    said = run("drive_server.py", url, "out.jpg")
    assert said.count("bytes; ms:") == 5 and cv2.imread("out.jpg").shape == (384, 384, 3)


def test_a_client_in_javascript(url: str, tmp_path: Path) -> None:
    require("node")
    major = int(subprocess.run([program("node"), "--version"], capture_output=True, text=True).stdout[1:].split(".")[0])
    if major < 22:
        done = subprocess.run([program("node"), str(CLIENT), url], capture_output=True, text=True, timeout=60)
        assert done.returncode == 1 and "take 22 or newer, or 20 with" in done.stderr
    if major < 20:
        return  # which says all that it can
    words = [program("node"), *(["--experimental-websocket"] if major < 22 else []), str(CLIENT)]
    done = subprocess.run([*words, url], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.count("512 x 512") == 10, done.stderr
    left, right = (cv2.imread(str(tmp_path / f"{side}.jpg")) for side in ("left", "right"))
    assert all(0.02 < figure(eye) < 0.5 for eye in (left, right)) and (left != right).any()
    alone = subprocess.run([*words, "ws://127.0.0.1:9/ws"], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert "no server at ws://127.0.0.1:9/ws" in alone.stderr


def test_a_custom_solver(run: Run) -> None:
    said = run("custom_solver.py")
    assert float(said.split("neck [")[1].split(",")[0]) > 0.3 and "solver_failed" not in said
    assert 0.05 < figure(cv2.imread("solved.png")) < 0.5


def test_walk_clip(run: Run, tmp_path: Path) -> None:
    """A motion of the test's own, an arm that sinks within half a second; every frame is in the clip."""
    frames = [{"body_pose": [[0, 0, 0]] * 15 + [[0, 0, -0.1 * step]] + [[0, 0, 0]] * 5} for step in range(12)]
    (tmp_path / "sink.json").write_text(json.dumps({"fps": 24, "frames": frames}))
    said = run("walk_clip.py", "wave.mp4", "sink.json")
    count = int(said.split(": ")[1].split()[0])
    reader, shown = cv2.VideoCapture("wave.mp4"), []
    while (got := reader.read())[0]:
        shown.append(got[1])
    reader.release()
    assert len(shown) == count == 24 and shown[0].shape == (320, 240, 3)
    assert np.abs(shown[0].astype(int) - shown[8]).mean() > 1  # it moves
    assert cv2.imread("wave.mp4.png").shape == (320, 960, 3)
    with pytest.raises(SystemExit, match="could not be written"):
        run("walk_clip.py", "nowhere/walk.mp4", "sink.json")


def test_depth_picture(run: Run) -> None:
    said = run("depth_picture.py")
    near, far = (float(part.split(" m")[0].split()[-1]) for part in said.split(" (")[:2])
    assert 1.5 < near < 2.6 < 4 < far < 5.5  # the camera is 2.5 m before the person, the floor ends 2 m behind
    colour, depth = np.split(cv2.imread("depth.png"), 2, axis=1)
    assert ((colour.max(axis=2) > 12) == (depth.max(axis=2) > 12)).mean() > 0.97  # both show the same outline


def test_levels_of_detail(run: Run) -> None:
    said = run("levels_of_detail.py")
    counts = [int(part.split(" splats")[0].split()[-1]) for part in said.split(";")]
    assert counts == sorted(counts, reverse=True) == [40000, 14000, 7000, 4500]
    finest, first, *_, last = np.split(cv2.imread("levels.png"), 4, axis=1)
    assert np.abs(finest.astype(int) - first).mean() < 2 and figure(last) < 0.5 * figure(finest)


def test_cutout(run: Run, tmp_path: Path) -> None:
    """Before a picture of one's own: what the avatar does not cover is that picture to the byte."""
    noise = np.random.default_rng(5).integers(0, 255, (480, 480, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "behind.png"), noise)
    run("cutout.py", "out.png", "behind.png")
    picture = cv2.imread("out.png")
    same = (picture == noise).all(axis=2)
    assert same[:, :60].all() and 0.6 < same.mean() < 0.95
    with pytest.raises(SystemExit, match=r"none\.jpg could not be read"):
        run("cutout.py", "out.png", "none.jpg")


def test_recolour(run: Run) -> None:
    said = run("recolour.py", "out.png", "orange.glb")
    before, after = np.split(cv2.imread("out.png").astype(int), 2, axis=1)
    blue = [(picture[..., 0] - picture[..., 2] > 60).sum() for picture in (before, after)]
    assert blue[0] > 5000 and blue[1] < 0.15 * blue[0]
    changed, old = load("orange.glb").splats, default_avatar().splats
    assert int(said.split(": ")[1].split()[0]) == (changed.sh != old.sh).any(axis=(1, 2)).sum() > 1000
    assert (changed.means == old.means).all()


def test_score_an_avatar(run: Run, tmp_path: Path) -> None:
    """The embedded body against a mesh of boxes on its joints: it scores badly."""
    save(part(default_avatar(), np.arange(0, 40000, 20)), tmp_path / "me.glb")
    save_person(boxes(), tmp_path / "person.npz")
    said = run("score_avatar.py", "me.glb", "person.npz", 1)
    assert said.count("SSIM") == 2 and 1 < float(said.split("worst ")[1].split()[0]) < 25
    save(limb(), "limb.glb")
    for words, reason in (
        ("me.glb", "POSES is 1 to 8"),
        ("me.glb person.npz few", "POSES is 1 to 8"),
        ("me.glb person.npz 0", "POSES is 1 to 8"),
        ("no.glb person.npz", "no.glb: cannot be read"),
        ("person.npz me.glb", "needs an avatar and the rigged mesh"),
        ("limb.glb person.npz", "score against the mesh it was made from"),
    ):
        with pytest.raises(SystemExit, match=reason):
            run("score_avatar.py", *words.split())


def figure(picture: np.ndarray) -> float:
    """The share of a picture that is not its corner's colour."""
    return float((np.abs(picture.astype(int) - picture[0, 0]).max(axis=2) > 12).mean())
