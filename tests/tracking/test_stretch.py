"""Arms that become a little longer where the user's are."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, TrackerConfig
from glsplat.tracking.solve.body import ELBOWS, SHOULDERS, WRISTS
from tests.tracking.moves import DT, Stage, Track, seconds

RAW = TrackerConfig.raw()
STIFF = TrackerConfig(stretch=0.0)


def reaching(stage: Stage, times: float, side: float = 1.0) -> tuple[float, float, float]:
    """A place before the shoulder, ``times`` an arm's length away."""
    shoulder, elbow, wrist = (stage.body.rest[pair[0]] for pair in (SHOULDERS, ELBOWS, WRISTS))
    length = np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)
    at = shoulder * (side, 1, 1) + np.array([0.1 * side, -0.3, 0.95]) * times * length
    return float(at[0]), float(at[1]), float(at[2])


@pytest.mark.parametrize("times", [0.8, 1.05, 1.15])
def test_the_wrist_is_at_the_hand(stage: Stage, track: Track, times: float) -> None:
    """Of one arm's length and of a little more, the same picture: shoulder, elbow and wrist on the way to the hand."""
    place = reaching(stage, times)
    result = track([stage.sample(t, left=place) for t in seconds(1)], config=RAW)
    assert np.linalg.norm(result.joints[-1, WRISTS[0]] - place) < 0.005
    assert result.reach[-1][0] < 0.005 and "left_out_of_reach" not in result.flags[-1]


def test_beyond_a_quarter_more_it_points_there(stage: Stage, track: Track) -> None:
    place = reaching(stage, 1.6)
    result, stiff = (track([stage.sample(t, left=place) for t in seconds(1)], config=c) for c in (RAW, STIFF))
    wrist, at_rest = (run.joints[-1, WRISTS[0]] for run in (result, stiff))
    shoulder = result.joints[-1, SHOULDERS[0]]
    assert np.linalg.norm(wrist - shoulder) == pytest.approx(1.25 * np.linalg.norm(at_rest - shoulder), rel=1e-3)
    assert result.reach[-1][0] == pytest.approx(np.linalg.norm(wrist - place), abs=1e-6)
    assert "left_out_of_reach" in result.flags[-1]


def test_rotations_are_those_of_arms_that_stay_as_long_as_they_are(stage: Stage, skeleton: Skeleton) -> None:
    one, other = Tracker(skeleton), Tracker(skeleton, config=STIFF)
    for t in seconds(2):
        sample = stage.sample(t, left=reaching(stage, 0.7 + 0.3 * t), right=reaching(stage, 1.3 - 0.3 * t, -1.0))
        a, b = one.update(sample), other.update(sample)
        assert np.array_equal(a.rotations, b.rotations) and np.array_equal(a.trans, b.trans)
        assert b.translations is None


@pytest.mark.parametrize(("solver", "times"), [("analytic", 1.18), ("learned", 1.25)])  # whose chest turns to it
def test_it_comes_and_goes_smoothly(stage: Stage, track: Track, solver: str, times: float) -> None:
    """Out, lost, found again: the wrist is never faster than 12 m/s and is back at its length in half a second."""
    far = reaching(stage, times)
    samples = [stage.sample(t, left=None if 1.0 < t < 2.0 else far) for t in seconds(3)]
    result = track(samples, config=RAW, solver=solver)
    arm = np.linalg.norm(result.joints[:, WRISTS[0]] - result.joints[:, ELBOWS[0]], axis=1)
    rest = np.linalg.norm(stage.body.rest[WRISTS[0]] - stage.body.rest[ELBOWS[0]])
    lost = int(1.6 / DT)
    assert arm[0] > 1.05 * rest and arm[lost] == pytest.approx(rest, rel=1e-3) and arm[-1] > 1.01 * rest
    speed = np.linalg.norm(np.diff(result.joints[:, WRISTS[0]], axis=0), axis=1) / DT
    assert speed.max() < 12


def test_a_new_user_begins_with_arms_at_rest(stage: Stage, skeleton: Skeleton) -> None:
    tracker = Tracker(skeleton, config=RAW)
    tracker.update(stage.sample(0.0, left=reaching(stage, 1.15)))
    tracker.reset()
    assert tracker.update(stage.sample(1.0)).translations is None


@pytest.mark.parametrize("stretch", [-0.1, 1.5, float("nan")])
def test_a_stretch_that_is_none_is_refused(stretch: float) -> None:
    with pytest.raises(PoseError, match="stretch needs 0 to 1"):
        TrackerConfig(stretch=stretch)
