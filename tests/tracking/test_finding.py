"""A size that is found while the session runs, and feet that no hand moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Calibration, Tracker
from glsplat.tracking.finding import POSTURE
from glsplat.tracking.solve.body import FEET
from tests.tracking.moves import Stage, Track, seconds


def scales(skeleton: Skeleton, stage: Stage, size: float, low: float, begins: float) -> list[float]:
    """Of a session of somebody ``size`` times the avatar who is ``low`` of that for ``begins`` seconds, then stands."""
    tracker, found = Tracker(skeleton, Calibration(automatic=True)), []
    rng = np.random.default_rng(2)
    for t in seconds(begins + 10, 1 / 30):
        down = low * min(max((begins - t) / 0.8, 0.0), 1.0)
        height = (POSTURE - down) * size * stage.body.eye_height + rng.normal(0, 0.003)
        tracker.update(stage.sample(t, head=(0.02 * np.sin(t), height, 0.1), left=None, right=None))
        found.append(tracker.calibration.scale)
    return found


@pytest.mark.parametrize("size", [0.8, 0.9, 1.0, 1.1])
@pytest.mark.parametrize(("low", "begins"), [(0.0, 0.0), (0.27, 4.0), (0.2, 4.0)], ids=["stands", "sits", "crouches"])
def test_a_size_is_found_within_ten_seconds_of_standing(
    skeleton: Skeleton, stage: Stage, size: float, low: float, begins: float
) -> None:
    found = scales(skeleton, stage, size, low, begins)
    assert found[-1] == pytest.approx(size, rel=0.03)
    assert abs(found[90] / size - 1) < abs(1 / size - 1) + 0.01  # after 3 s no worse than without
    assert np.abs(np.diff(found)).max() * 30 < 0.16  # a second; nothing jerks
    assert np.abs(np.diff(found, 2)).max() < 2e-3


def test_an_explicit_calibration_wins(skeleton: Skeleton, stage: Stage) -> None:
    tracker = Tracker(skeleton, Calibration(scale=1.1))
    for t in seconds(5.0, 1 / 30):
        tracker.update(stage.sample(t, head=(0.0, 1.4, 0.1)))
    assert tracker.calibration.scale == 1.1


def test_the_file_of_a_calibration_says_that_it_is_automatic(tmp_path: Path) -> None:
    path = tmp_path / "me.json"
    for known in (Calibration(scale=0.9, automatic=True), Calibration(scale=0.9)):
        known.save(path)
        assert Calibration.load(path) == known
    path.write_text('{"scale": 1, "automatic": 1}')
    with pytest.raises(FormatError, match="automatic"):
        Calibration.load(path)


def test_a_hand_raised_beside_a_still_head_moves_no_foot(stage: Stage, track: Track) -> None:
    samples = []
    for t in seconds(6.0):
        up = 0.5 - 0.5 * np.cos(np.pi * np.clip(t - 2, 0, 2))
        samples.append(stage.sample(t, left=(0.25 + 0.3 * up, 1.07 + 0.8 * up, 0.15 + 0.1 * up)))
    feet = track(samples, solver="learned").joints[72:, list(FEET)]
    assert np.ptp(feet, axis=0).max() < 0.01
