from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, record, replay
from glsplat.tracking.recording import MAX_LINE, embedded_recording, read_poses, write_lines
from tests.tracking.moves import Stage, seconds


def test_record_and_replay(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "rec.jsonl"
    samples = [stage.sample(t, left=None, right_curl=0.5) for t in seconds(0.1)]
    assert record(path, samples) == len(samples)
    again = list(replay(path))
    assert [s.t for s in again] == pytest.approx([s.t for s in samples], abs=1e-6)
    np.testing.assert_allclose([s.head for s in again], [s.head for s in samples], atol=1e-6)
    assert again[0].left is None and again[0].right_curl == 0.5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rec.jsonl"]


def test_a_failed_recording_leaves_the_old_file(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "rec.jsonl"
    path.write_text("old")

    def broken():
        yield stage.sample(0.0)
        raise RuntimeError("unplugged")

    with pytest.raises(RuntimeError):
        record(path, broken())
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    "text", ["{", "[1, 2]", '{"t": 0}', '{"head": [1, 2]}', '{"head": "here"}', "null", "\x00\x01", "[" * 100_000]
)
def test_bad_lines_name_file_and_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rec.jsonl"
    path.write_text('{"t": 0, "head": [0, 1, 0, 0, 0, 0, 1]}\n\n' + text + "\n")
    with pytest.raises(FormatError, match=r"rec\.jsonl, line 3"):
        list(replay(path))
    with pytest.raises(FormatError, match=r"rec\.jsonl, line 1"):
        read_poses(path)


@pytest.mark.check
def test_a_recording_of_any_size_is_replayed(tmp_path: Path) -> None:
    """Line by line: what was recorded is read, however long it went on."""
    path = tmp_path / "rec.jsonl"
    with open(path, "wb") as file:
        for _ in range(1040):
            file.write(b" " * (MAX_LINE - 1) + b"\n")
        file.write(b'{"t": 0, "head": [0, 1, 0, 0, 0, 0, 1]}\n')
    assert path.stat().st_size > 1 << 30
    assert [sample.t for sample in replay(path)] == [0]


def test_missing_and_empty_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="none"):
        list(replay(tmp_path / "none.jsonl"))
    (tmp_path / "empty.jsonl").write_text("\n")
    assert list(replay(tmp_path / "empty.jsonl")) == []
    with pytest.raises(FormatError, match="found none"):
        read_poses(tmp_path / "empty.jsonl")


def test_numbers_are_rounded_and_nan_is_null(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    write_lines(path, [{"a": 1 / 3, "b": [math.nan, math.inf], "c": "text", "d": None, "e": 3}])
    assert json.loads(path.read_text()) == {"a": 0.333333, "b": [None, None], "c": "text", "d": None, "e": 3}


def test_the_embedded_recording_is_ordinary(skeleton: Skeleton) -> None:
    samples = embedded_recording()
    steps = np.diff([s.t for s in samples])
    assert len(samples) > 300 and steps == pytest.approx(np.full(len(steps), 1 / 72), abs=2e-6)
    tracker = Tracker(skeleton)
    for sample in samples:
        pose = tracker.update(sample)
        assert np.isfinite(pose.rotations).all()
        assert not {"teleport", "gap", "head_lost", "head_limit", "airborne"} & set(tracker.flags)
