"""Times of stages."""

from __future__ import annotations

from glsplat.net.pace.stages import StageTimes


def test_frames_are_counted_and_the_last_ones_summed_up() -> None:
    times = StageTimes(3)
    for ms in (1000.0, 1.0, 2.0, 6.0):
        times.add({"draw": ms})
    times.add({"encode": 0.5})
    assert times.frames == 5 and times.lately(60)
    summary = times.summary()
    assert summary["draw"]["median"] == 2.0 and summary["encode"] == {"median": 0.5, "p95": 0.5}
