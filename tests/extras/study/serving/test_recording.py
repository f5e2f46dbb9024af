"""Tracking and figures on disk: whole lines, no wait, and what a full disk costs."""

from __future__ import annotations

import json
import logging
import threading
import time
from pathlib import Path

import pytest

from glsplat.extras.study.serving import recording
from glsplat.extras.study.serving.recording import Recording


def test_lines_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "tracking.jsonl"
    for _ in range(2):  # the second goes on behind the first
        one = Recording(path)
        for n in range(500):
            one.add(n / 3, "x", "tracking", {"head": [n / 7, float("nan")], "left": None})
        one.close()
        assert one.lost == 0
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert len(lines) == 1000 and [line["t"] for line in lines[:500]] == [round(n / 3, 3) for n in range(500)]
    assert lines[3]["values"] == {"head": [0.42857, None], "left": None}


def test_a_full_disk_costs_lines_and_nothing_else(caplog: pytest.LogCaptureFixture) -> None:
    one = Recording(Path("/dev/full"))
    for n in range(10):
        one.add(n, "x", "tracking", {})
        time.sleep(0.01)
    one.close()
    assert one.lost == 10
    assert len([r for r in caplog.records if r.levelno == logging.ERROR]) == 1  # said once


def test_a_slow_disk_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    monkeypatch.setattr(recording, "_append", lambda path, data: gate.wait(20))
    one = Recording(tmp_path / "x")
    begun = time.monotonic()
    for n in range(12000):
        one.add(n, "x", "tracking", {})
    assert time.monotonic() - begun < 5 and one.lost > 3000
    gate.set()
    one.close()


@pytest.mark.parametrize(("limit", "value", "said"), [("MAX_BYTES", 3000, "most that is recorded"),
                                                     ("MIN_FREE_BYTES", 1 << 62, "kept for answers")])  # fmt: skip
def test_a_recording_leaves_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, limit: str, value: int, said: str
) -> None:
    """It ends at its size, and before the disk is full: the log's answers need it."""
    monkeypatch.setattr(recording, limit, value)
    path = tmp_path / "tracking.jsonl"
    one = Recording(path)
    for n in range(1000):
        one.add(n, "x", "tracking", {"head": [n] * 7})
    one.close()
    size = path.stat().st_size if path.exists() else 0
    lines = path.read_text().splitlines() if size else []
    assert size <= 3000 and one.lost == 1000 - len(lines) > 0 and all(map(json.loads, lines))
    assert [said in record.getMessage() for record in caplog.records] == [True]
