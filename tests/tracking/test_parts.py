"""Parts of the solvers by themselves: gait, steps, feet, expected errors, and where a walk began."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, TrackerConfig
from glsplat.tracking.finding import SHOULDERS, Finder
from glsplat.tracking.learned.expected import ExpectedError
from glsplat.tracking.learned.feet import SET, Feet
from glsplat.tracking.learned.hints import FootHint
from glsplat.tracking.solve.body import COLLARS, HEAD, PELVIS, Body
from glsplat.tracking.solve.body import SHOULDERS as SHOULDER_JOINTS
from glsplat.tracking.solve.quat import IDENTITY, inverse_mul, rotation_angle, to_quat
from glsplat.tracking.solve.solution import Targets
from glsplat.tracking.solve.stepping.foot import Foot
from glsplat.tracking.solve.stepping.gait import Gait
from glsplat.tracking.solve.stepping.leg import Leg
from glsplat.tracking.solve.stepping.legs import STEP_TIME, STEP_TURN, Legs
from glsplat.tracking.solve.tracked import FOUND, Follow
from tests.tracking.moves import DT, Stage, seconds


def phases(heading: float) -> list[float]:
    """Of a walk that way, facing elsewhere, whose head sways by 3 cm."""
    gait, s, c = Gait(0.83), sin(heading), cos(heading)
    out = []
    for t in seconds(4):
        along, across = 1.2 * t, 0.03 * sin(2 * pi * 0.9 * t)
        neck = (along * s + across * c, 1.4, along * c - across * s)
        gait.update(neck, 0.4, None, None, (1.2 * s, 0.0, 1.2 * c), 1.2, 0.96, True, DT)
        out.append(gait.phase)
    return out


def test_sway_is_across_the_way_a_walk_goes() -> None:
    north = phases(0.0)
    assert len(set(north)) > 100
    for heading in (pi / 2, pi, 1.0):
        assert phases(heading) == pytest.approx(north, abs=1e-6)


@pytest.mark.parametrize("low", [True, False])
def test_hands_at_the_bounds_of_shoulder_height_are_not_stretched(body: Body, low: bool) -> None:
    finder = Finder(body, 1.0)
    for height, counts in ((SHOULDERS[0 if low else 1], False), (0.9, True)):
        hands = [(x, height, 0.0) for x in (-0.7, 0.7)]
        finder.update((0.0, 1.0, 0.0), IDENTITY, hands, DT)
        assert (finder.spans.sum() > 0) == counts


def test_a_body_that_stands_is_not_far_from_where_it_is_shown(body: Body) -> None:
    """Nobody's collars are further off than their pelvis."""
    expected = ExpectedError(body.eye_height)
    out = expected.update(Targets((0.0, body.eye_height, 0.0), IDENTITY), 0.05, DT)
    assert 0.01 < out[PELVIS] < 0.3
    assert all(0.01 < out[joint] < out[PELVIS] for joint in (HEAD, *COLLARS, *SHOULDER_JOINTS))


def test_a_foot_is_set_down_however_the_samples_divide_the_time(body: Body) -> None:
    """It lands where no time is left, not only where less is."""
    feet, pelvis = Feet(body), body.joints[PELVIS]
    x, _, z = body.joints[10]
    still = FootHint((-x, feet.sole, z), (0.0, 0.0, 0.0), 0.0, 0.0, 1.0, 1.0, (-x, 0.5, z))
    for place, stands, times in ((0.0, 1.0, 10), (0.3, 0.0, 5), (0.3, 1.0, 3)):
        hint = FootHint((x, feet.sole, z + place), (0.0, 0.0, 0.0), 0.0, 0.0, stands, 1.0, (x, 0.5, z))
        for _ in range(times):
            feet.update([hint, still], pelvis, IDENTITY, 0.0, SET / 2)
        assert feet.feet[0].planted == (stands > 0)


def test_the_further_a_foot_is_off_the_quicker_it_steps(body: Body) -> None:
    durations = []
    for turn in (1.1, 2.2, 3.3):
        legs, pelvis = Legs(body), body.joints[PELVIS]
        for yaw in (0.0, turn * STEP_TURN / 1.3):  # a step looks 0.3 s ahead in a turn
            legs.update((0.0, 0.0, 0.0), pelvis, IDENTITY, yaw, (0.0,) * 3, (0.0,) * 3, 0.0, 1.0)
        durations.append(next(foot.duration for foot in legs.feet if not foot.planted))
    assert durations == pytest.approx([STEP_TIME * share for share in (1.0, 0.86, 0.64)], rel=1e-3)


def test_a_foot_whose_tracker_is_found_turns_towards_it(body: Body) -> None:
    leg = Leg(body, 0)
    follow, foot, turn = Follow(leg), Foot(0), to_quat((0.0, 1.0, 0.0))
    foot.plant((0.1, leg.sole, 0.0), 0.0)
    follow.place(foot, None, None, DT)
    angles = []
    for _ in seconds(FOUND + 2 * DT):
        follow.place(foot, ((0.1, 0.1, 0.0), turn), None, DT)
        angles.append(rotation_angle(inverse_mul(follow.turn, turn)))
    assert angles[0] == pytest.approx(1.0, abs=0.02) and angles[-1] == pytest.approx(0.0, abs=1e-6)
    assert angles == sorted(angles, reverse=True)


@pytest.mark.parametrize("speed", [0.45, 1.2])
def test_a_walk_is_the_same_wherever_it_begins(skeleton: Skeleton, stage: Stage, speed: float) -> None:
    poses = []
    for begin in (0.0, 3.0):
        tracker = Tracker(skeleton, config=TrackerConfig.raw())
        moved = [(begin, 0.0, speed * t) for t in seconds(1.0)]
        samples = [
            stage.sample(i * DT, *(tuple(np.add(place, by)) for place in (stage.eye,)), left=None, right=None)
            for i, by in enumerate(moved)
        ]
        poses.append(np.array([tracker.update(sample).rotations for sample in samples]))
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-6)
