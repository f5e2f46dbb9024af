"""The replay client: what it reports, what it saves, and its errors."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg

from apps.replay import command as replay
from apps.replay.stage_table import table_markdown
from apps.replay.streaming import POLICIES, STAGES, Result, observer
from glsplat.errors import GlsplatError
from glsplat.net.reply import pack_reply, parse_reply
from tests.apps.cli import parsed


def recording(path, count=10):
    lines = [json.dumps({"t": i / 30, "head": [0, 1.6, 0, 0, 0, 0, 1], "left": None}) for i in range(count)]
    path.write_text("\n".join([*lines, ""]))
    return path


def test_the_report_adds_up(stripes, capsys):
    url, backend = stripes
    args = parsed(replay, "walk", "--url", url, "--frames", 40, "--fps", 60, "--size", "64x64", "--json")
    assert replay.run(args) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["sent"] == 40 and out["received"] + out["dropped"] == 40 and out["errors"] == 0
    assert out["shown"] + out["late"] == out["received"] > 1
    assert out["driver"] == "numpy" and out["bytes_per_frame"] > 500
    stages = {name: row["median"] for name, row in out["stages_ms"].items()}
    assert set(stages) == {key for key, _, _ in STAGES} | {"render/skin", "render/draw"}
    assert 0 < stages["render"] < stages["end_to_end"]
    assert out["age_ms"]["median"] >= stages["end_to_end"] - 1
    poses = [request.pose for request in backend.requests]
    assert not np.array_equal(poses[0].rotations, poses[-1].rotations)  # the motion moves
    spots = [request.cameras[0].position for request in backend.requests]
    assert 0 < np.linalg.norm(spots[-1] - spots[0]) < 1  # the observer sways


def test_the_table_for_people(stripes, capsys):
    assert replay.run(parsed(replay, "walk", "--url", stripes[0], "--frames", 5, "--size", 64)) == 0
    text = capsys.readouterr().out
    for _, name, _ in STAGES:
        assert name in text
    assert "5 asked" in text and "drawn by numpy" in text and "  skin" in text


def test_pictures_are_saved(stripes, tmp_path):
    words = ("walk", "--url", stripes[0], "--frames", 8, "--fps", 60, "--size", 64)
    for name in ("sheet.png", "clip.mp4", "pairs/"):
        assert replay.run(parsed(replay, *words, "--save", f"{tmp_path}/{name}")) == 0
    files = sorted((tmp_path / "pairs").glob("*.png"))
    assert 1 <= len(files) <= 8
    image = cv2.imread(str(files[0]))
    assert image.shape == (64, 128, 3) and image[32, 32, 2] > 180 and image[32, 96, 2] > 180
    clip = cv2.VideoCapture(str(tmp_path / "clip.mp4"))
    assert clip.get(cv2.CAP_PROP_FRAME_WIDTH) == 128 and clip.get(cv2.CAP_PROP_FRAME_COUNT) >= 1
    clip.release()
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] == 2 * 128 + 4
    assert {p.name for p in tmp_path.iterdir()} == {"sheet.png", "clip.mp4", "pairs"}


def test_a_recording_is_sent_as_tracking(stripes, tmp_path):
    url, backend = stripes
    path = recording(tmp_path / "head.jsonl")
    with pytest.raises(GlsplatError, match=r"^this server has no tracking solver: send pose instead of tracking$"):
        replay.run(parsed(replay, path, "--url", url, "--frames", 3, "--size", 64))
    assert not backend.requests
    drive, seconds = replay.load_drive(str(path))
    assert seconds == pytest.approx(0.3)
    assert drive.at(0.1).tracking["head"] == [0, 1.6, 0, 0, 0, 0, 1] and drive.at(99.0).pose is None
    for text in ("", "{", '{"t": 0}', '{"head": [1]}', "[" * 5000):
        path.write_text(text)
        with pytest.raises(GlsplatError, match=r"head\.jsonl"):
            replay.load_drive(str(path))


def test_the_observer_sees_the_whole_avatar():
    for seconds in np.linspace(0, 60, 40):
        for camera in observer(seconds, np.array([0.5, 0.1, -0.2]), (400, 300)):
            for point in ((0.5, 0.0, -0.2), (0.5, 1.85, -0.2), (0.0, 1.2, -0.2), (1.0, 1.2, -0.2)):
                x, y, z = camera.K @ (camera.viewmat @ (*point, 1))[:3]
                assert z > 1 and 0 < x / z < 400 and 0 < y / z < 300


def test_the_markdown_table_has_a_column_pair_a_run():
    result = Result(sent=2, received=2, shown=2, seconds=0.5, driver="llvmpipe", nbytes=[1000, 3000], ages=[10.0, 12.0])
    result.times = {"render": [20.0, 30.0], "render/draw": [15.0, 16.0], "end_to_end": [40.0, 41.0]}
    text = table_markdown([("512x512", result), ("1024x1024", result)])
    rows = [line for line in text.splitlines() if line.startswith("|")]
    assert len({row.count("|") for row in rows}) == 1
    assert "| stereo rendering | server | 25.00 | 29.50 | 25.00 | 29.50 |" in rows
    assert "llvmpipe" in text and "simplejpeg" in text


def test_smaller_pictures_between_are_enlarged(tmp_path: Path) -> None:
    """A server that holds a rate sends them; a clip and a sheet have one size."""
    kept = []
    for i, side in enumerate((64, 32, 64, 40)):
        image = np.full((side, side, 3), 50 * i, np.uint8)
        jpeg = simplejpeg.encode_jpeg(image)
        kept.append((0.1 * i, parse_reply(pack_reply(i, (0, 1), [jpeg, jpeg], {"size": [side, side]}))))
    replay.save_sheet(tmp_path / "sheet.png", kept)
    assert "4 pictures" in replay.save_clip(tmp_path / "clip.webm", kept)
    assert cv2.imread(str(tmp_path / "sheet.png")).shape[1] >= 2 * 128


def test_policies_are_compared_and_a_loop_ends_by_its_time(stripes, capsys):
    url, backend = stripes
    words = ("walk", "--url", url, "--fps", 60, "--size", "64x64", "--json")
    assert replay.run(parsed(replay, *words, "--seconds", 0.5)) == 0
    assert json.loads(capsys.readouterr().out)["sent"] == 30
    backend.delay = 0.01
    assert replay.run(parsed(replay, *words, "--frames", 20, "--compare", "--link", "0,1000", "--link", "30,50")) == 0
    runs = json.loads(capsys.readouterr().out)
    places = ("0 ms, 1000 Mbit/s", "30 ms, 50 Mbit/s")
    assert [(run["link"], run["policy"]) for run in runs] == [(place, how) for place in places for how in POLICIES]
    for run in runs:
        assert run["received"] + run["dropped"] == run["sent"] and run["errors"] == 0
    assert all(run["beyond_render_ms"]["median"] >= 29 for run in runs[3:])  # the round trip
