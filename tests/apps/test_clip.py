"""Clips: a codec that browsers play, every frame in it, and nothing left behind when the disk is full."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from apps import clip as module
from apps.clip import Clip
from glsplat.errors import FormatError


def picture(step: int, width: int = 96, height: int = 64) -> np.ndarray:
    """A disc on a gradient that moves; smooth enough for 4:2:0."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    disc = np.clip(20 - np.hypot(x - 20 - 4 * step, y - 30), 0, 1)[..., None]
    return np.uint8(disc * (40, 180, 250) + (1 - disc) * np.stack([x, y, 80 + 0 * x], axis=-1))


def frames(path: Path) -> list[np.ndarray]:
    reader = cv2.VideoCapture(str(path))
    found = []
    while (got := reader.read())[0]:
        found.append(cv2.cvtColor(got[1], cv2.COLOR_BGR2RGB))
    reader.release()
    return found


@pytest.mark.parametrize(("ending", "count", "fps"), [(".mp4", 31, 10.37), (".WebM", 31, 10.37), (".mp4", 1, 240.0)])
def test_every_frame_arrives_in_order(tmp_path, capfd, ending, count, fps):
    path = tmp_path / f"clip{ending}"
    with Clip(path, fps) as clip:
        for step in range(count):
            clip.add(picture(step))
    assert clip.summary == f"{path}: {count} pictures, {fps:g} a second, VP9"
    data = path.read_bytes()
    assert b"mp4v" not in data and (b"vp09" if ending == ".mp4" else b"V_VP9") in data  # browsers play it
    got = frames(path)
    assert len(got) == count
    for step, image in enumerate(got):
        assert np.abs(image.astype(float) - picture(step)).mean() < 3  # the next picture is 5 off
    assert capfd.readouterr() == ("", "")  # nor does the library print
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_an_opencv_without_vp9_says_what_it_wrote(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "CLIPS", {".mp4": "zzzz", ".webm": "zzzz"})
    with Clip(tmp_path / "a.mp4", 10) as clip:
        clip.add(picture(0))
    assert "MPEG-4 part 2, which browsers do not play" in clip.summary and len(frames(tmp_path / "a.mp4")) == 1
    with pytest.raises(FormatError, match="cannot write such a clip"), Clip(tmp_path / "a.webm", 10) as clip:
        clip.add(picture(0))


@pytest.mark.check
@pytest.mark.parametrize(
    ("name", "kibibytes", "samples"),
    [("a.webm", 1, 0), pytest.param("a.mp4", 200, 500_000, marks=pytest.mark.extra(name="speech"))],
)
def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, name, kibibytes, samples):
    """VP9 writes when it ends, so few frames are enough; the sound alone does not fit behind the .mp4."""
    sound = f"sound.Sound(noise.uniform(-1, 1, {samples}).astype('f4'), 48000)" if samples else None
    script = (
        "import sys, numpy as np; from apps import clip; from glsplat.errors import FormatError\n"
        f"{'from glsplat.extras.speech import sound' if samples else ''}\n"
        "noise = np.random.default_rng(1)\n"
        "try:\n"
        f"    with clip.Clip(sys.argv[1], 30, {sound}) as made:\n"
        "        for _ in range(6): made.add(noise.integers(0, 255, (128, 128, 3), dtype=np.uint8))\n"
        "except FormatError as error: print(error)\n"
    )
    limited = f'ulimit -f {kibibytes}; exec {sys.executable} -c "$1" "$2"'
    command = ["bash", "-c", limited, "sh", script, tmp_path / name]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=120)
    assert done.stderr == "" and done.returncode == 0
    assert done.stdout.count("\n") == 1 and done.stdout.startswith(f"{tmp_path}/{name}: ")
    assert list(tmp_path.iterdir()) == []


def test_an_error_leaves_the_old_clip(tmp_path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")
    with pytest.raises(KeyError), Clip(path, 10) as clip:
        clip.add(picture(0))
        raise KeyError
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
