"""The gate of measurements."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from glsplat.errors import GlsplatError
from glsplat.extras.evaluate import frames
from glsplat.extras.evaluate.frames import MAX_SHARE, Quiet, Watch, until_quiet
from tools.docs.precision import check_quiet

BUSY = "while True: pass"


@pytest.mark.check
@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="the CPU time of others is known on Linux alone")
def test_the_gate_refuses_beside_two_busy_loops() -> None:
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(2)]
    try:
        watch = Watch()
        time.sleep(1.0)
        found = watch.read(noise=0.0)
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()
    assert not found.ok and found.others is not None and found.others > MAX_SHARE
    with pytest.raises(GlsplatError, match=r"moving-512: not written: expected .* 3%\), got: other processes used"):
        check_quiet("moving-512", found)


def test_own_work_and_children_are_not_others(monkeypatch: pytest.MonkeyPatch) -> None:
    readings = iter([(100.0, 40.0, 10.0), (110.0, 46.0, 15.9)])  # of all cores: in all, busy, own
    monkeypatch.setattr(frames, "_seconds", lambda: next(readings))
    assert Watch().read(0.01) == Quiet(0.01, 0.01)


def test_a_noisy_measurement_is_repeated_once_at_twice_the_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "_seconds", lambda: None)
    asked: list[int] = []
    lines: list[str] = []

    def measure(frames: int) -> tuple[str, float]:
        asked.append(frames)
        return f"{frames} frames", 0.3 / frames

    assert until_quiet(measure, 10, lines.append) == ("10 frames", Quiet(None, 0.03)) and asked == [10]
    assert until_quiet(measure, 6, lines.append) == ("12 frames", Quiet(None, 0.025)) and not lines
    assert not until_quiet(measure, 3, lines.append)[1].ok and "differs from itself by 5.0%" in lines[0]
