"""Users who stand, sit, climb or are taller than the avatar, and arms that become longer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat.errors import PoseError
from glsplat.extras.learned.hints import FootHint
from glsplat.extras.learned.posture import NETWORK_SHARE, OVER_CHAIR_S, Seat, Stance
from glsplat.extras.learned.uncertainty import MAX_ERROR_M, ExpectedError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Tracker, TrackerConfig
from glsplat.tracking.calibration import Calibration
from glsplat.tracking.checked_solver import checked
from glsplat.tracking.solve.body import ANKLES, ELBOWS, FEET, HEAD, KNEES, PELVIS, SHOULDERS, WRISTS, Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.solution import Solution, Targets
from glsplat.tracking.solvers import SOLVERS, SolverName
from tests.tracking.moves import DT, Stage, Track, head_turn, seconds

Place = tuple[float, float, float]


def hints_at(left: Place, right: Place) -> list[FootHint]:
    return [FootHint(ball, (0.0, 0.0, 0.0), 0.0, 0.0, 1.0, 1.0, ball) for ball in (left, right)]


def feet_at(left: Place, right: Place) -> list[Foot]:
    feet = [Foot(0), Foot(1)]
    for foot, place in zip(feet, (left, right), strict=True):
        foot.plant(place, 0.0)
    return feet


def stood(body: Body, moves: Callable[[float], Place], hint: Place, plain: Place) -> tuple[Stance, FootHint]:
    """The left foot's hint after two seconds of a head that ``moves`` from its rest place."""
    stance = Stance(body)
    x, _, z = body.joints[HEAD]
    other = (-0.15, 0.02, 0.0)
    hints = hints_at(hint, other)
    for i in range(144):
        a, b, c = moves(i * DT)
        targets = Targets((x + a, body.eye_height + b, z + c), (1.0, 0.0, 0.0, 0.0))
        hints = hints_at(hint, other)
        stance.update(targets, hints, feet_at(plain, other), DT)
    return stance, hints[0]


def test_a_lone_wild_guess_of_a_standing_foot_is_outvoted(body: Body) -> None:
    """The network's guess is a metre off: the analytic foot or the usual stance, whichever is nearer, halves that."""
    sane = (0.15, 0.02, -0.1)
    stance, hint = stood(body, lambda t: (0.0, 0.0, 0.0), (0.15, 0.02, 1.0), sane)
    assert stance.share == 1
    assert hint.ball[2] < NETWORK_SHARE * 1.0 + 0.05
    assert hint.ball[1] == 0.02  # only over the ground
    # a wild analytic foot changes nothing that the other two agree on
    home = stance.home[0]
    eye = body.joints[HEAD]
    agreed = (eye[0] + home[0], 0.02, eye[2] + home[2])
    _, hint = stood(body, lambda t: (0.0, 0.0, 0.0), agreed, (3.0, 0.02, 3.0))
    np.testing.assert_allclose(hint.ball, agreed, atol=1e-6)


def test_who_walks_squats_or_sits_has_the_feet_that_the_network_says(body: Body) -> None:
    far = (0.15, 0.02, 1.0)
    for moves in (lambda t: (0.0, 0.0, 1.2 * t), lambda t: (0.0, -0.35, 0.0)):
        stance, hint = stood(body, moves, far, (0.15, 0.02, -0.1))
        assert stance.share == 0 and hint.ball == far
    # who sways on the spot stands all the same
    stance, hint = stood(body, lambda t: (0.03 * np.sin(6 * t), 0.0, 0.0), far, (0.15, 0.02, -0.1))
    assert stance.share > 0.6


def test_a_body_says_how_far_off_it_is(stage: Stage, skeleton: Skeleton) -> None:
    """Twenty-two distances: small where a device is, larger for feet, for low heads, and without hands; smooth."""
    x, y, z = stage.eye
    tracker = Tracker(skeleton)
    said = []
    for t in seconds(4.0):
        low = 0.3 * y * min(max(t - 2.0, 0.0), 1.0)
        tracker.update(stage.sample(t, head=(x, y - low, z), turn=head_turn(0.1 * np.sin(t))))
        said.append(tracker.expected_error)
    table = np.array(said)
    assert table.shape == (len(said), 22) and np.isfinite(table).all() and (table >= 0).all()
    stands, low = table[140], table[-1]
    assert stands[HEAD] < stands[PELVIS] < stands[ANKLES[0]] < 0.5
    assert low[PELVIS] > 1.2 * stands[PELVIS]
    assert np.abs(np.diff(table, axis=0)).max() < 0.02
    blind = Tracker(skeleton, head_only=True)
    for t in seconds(1.0):
        blind.update(stage.sample(t))
    assert blind.expected_error[WRISTS[0]] > 0.05 > 10 * stands[WRISTS[0]]


def test_metres_are_the_users_and_the_analytic_solver_says_nothing(stage: Stage, skeleton: Skeleton) -> None:
    sample = stage.sample(0.0)
    whole = Tracker(skeleton)
    whole.update(sample)
    small = Tracker(skeleton, Calibration(scale=0.5))
    poses = {name: getattr(sample, name) for name in ("head", "left", "right")}
    small.update(replace(sample, **{name: (*np.multiply(p[:3], 0.5), *p[3:]) for name, p in poses.items()}))
    np.testing.assert_allclose(small.expected_error, np.multiply(whole.expected_error, 0.5), rtol=1e-6)
    plain = Tracker(skeleton, solver="analytic")
    plain.update(sample)
    assert plain.expected_error == ()


def test_a_solver_of_ones_own_may_say_it_too() -> None:
    known = Solution([(1.0, 0.0, 0.0, 0.0)] * 22, (0.0, 1.0, 0.0))
    known.expected_error = (0.1,) * 22
    assert checked(known).expected_error == (0.1,) * 22
    for wrong in ((0.1,) * 3, (-1.0,) + (0.1,) * 21, (float("nan"),) + (0.1,) * 21):
        known.expected_error = wrong
        with pytest.raises(PoseError, match="expected_error"):
            checked(known)


RATE = 30


def seated(stage: Stage, length: float, high: float = 0.76, lean: float = 0.0) -> list[Sample]:
    """Somebody on a chair who looks about and moves both controllers ahead of the chest."""
    samples = []
    for t in seconds(length, 1 / RATE):
        sway = 0.02 * np.sin(1.7 * t)
        forward = lean * np.clip(t - 6, 0, 1)
        eyes = (sway, high * stage.body.eye_height - 0.3 * forward + 0.01 * np.sin(2.3 * t), 0.13 + forward)
        left = (0.2 + 0.1 * np.sin(2 * t), eyes[1] - 0.35, 0.45 + forward)
        right = (-0.2, eyes[1] - 0.4 + 0.15 * np.sin(3 * t), 0.4 + forward)
        turn = head_turn(0.4 * np.sin(0.9 * t), 0.15)
        samples.append(stage.sample(t, head=eyes, turn=turn, left=left, right=right))
    return samples


@pytest.mark.parametrize("lean", [0.0, 0.2])
def test_a_seated_start_is_told_and_sits(stage: Stage, track: Track, lean: float) -> None:
    samples = seated(stage, 9.0, lean=lean)
    run = track(samples, solver="learned")
    late = slice(5 * RATE, None)
    assert all("sitting" in flags for flags in run.flags[late])
    eyes = np.array([s.head[:3] for s in samples])[late]  # type: ignore[index]
    pelvis, knees, feet = (run.joints[late, list(which)] for which in ((0,), KNEES, FEET))
    assert np.abs(pelvis[:RATE, 0, [0, 2]] - eyes[:RATE, [0, 2]] + [0, 0.13]).max() < 0.1  # below the head
    assert np.ptp(pelvis[:, 0], axis=0).max() < 0.07  # whatever the head does above it
    assert (knees[..., 1] > 0.35).all() and (knees[..., 2] > pelvis[..., 2] + 0.25).all()  # thighs ahead
    feet = feet[2 * RATE :]  # they have come to where they stay
    ahead = feet[-1, :, 2] - pelvis[-1, 0, 2]  # not folded under the seat
    assert 0.2 < ahead.min() and ahead.max() < 0.7
    assert np.ptp(feet, axis=0).max() < 0.05 and feet[..., 1].max() < stage.body.sole + 0.03
    assert np.abs(run.joints[late, HEAD, 1] - run.joints[late, HEAD, 1].mean()).max() < 0.08


def test_who_gets_up_stands(stage: Stage, track: Track) -> None:
    samples = seated(stage, 6.0)
    top = samples[-1].head
    for i, t in enumerate(seconds(3.0, 1 / RATE)):
        up = 0.5 - 0.5 * np.cos(np.pi * min(t, 1.0))
        height = top[1] + up * (0.98 * stage.body.eye_height - top[1])
        samples.append(stage.sample(6.0 + i / RATE, head=(top[0], height, top[2] + 0.3 * up)))
    run = track(samples, solver="learned")
    assert "sitting" in run.flags[6 * RATE - 1] and "sitting" not in run.flags[-1]
    assert run.joints[-1, 0, 1] > 0.9 * stage.body.joints[0][1] - stage.body.ground
    assert np.linalg.norm(np.diff(run.joints[:, 0], axis=0), axis=-1).max() * RATE < 3


@pytest.mark.parametrize(
    ("high", "pace", "dips"), [(0.76, 0.5, 0.0), (0.76, 0.0, 0.12), (0.98, 0.0, 0.0), (0.5, 0.0, 0.0)]
)
def test_who_walks_bobs_stands_or_kneels_sits_on_no_chair(body: Body, high: float, pace: float, dips: float) -> None:
    seat = Seat(body)
    for t in seconds(2 * OVER_CHAIR_S, 1 / RATE):
        eye = (pace * t, high * body.eye_height + dips * np.sin(4 * t), 0.0)
        assert seat.update((eye[0], 0.97 * seat.size, -0.1), eye, (1.0, 0.0, 0.0, 0.0), 1 / RATE) is None
    assert not seat.sits


EACH = pytest.mark.parametrize("solver", SOLVERS)


def climbing(stage: Stage, to: float, speed: float = 0.6, stays: float = 2.0, down: bool = True) -> list[Sample]:
    """A second on the floor, steps of 0.2 m, one every 0.8 s, and down again; the hands keep to the head."""
    x, y, z = stage.eye
    samples = []
    for i, t in enumerate([0.0] * 72 + seconds(9.0)):
        up = min(to, 0.2 * (t // 0.8) + min(0.2, speed * (t % 0.8)))
        rises = to / 0.2 * 0.8 + stays
        if down and t > rises:
            up = max(0.0, to - speed * (t - rises))
        places = {side: stage.hand(side) for side in ("left", "right")}
        hands = {side: (at[0], at[1] + up, at[2]) for side, at in places.items()}
        samples.append(stage.sample(i / 72, head=(x, y + up, z), **hands))
    return samples


@EACH
def test_who_climbs_stands_on_something(stage: Stage, track: Track, solver: SolverName) -> None:
    """1 m up and down again: head and hands stay exact to the end, legs straight, feet a metre up."""
    samples = climbing(stage, 1.0)
    result = track(samples, solver=solver)
    top = slice(int(6.0 * 72), int(6.8 * 72))
    sole = stage.body.sole
    assert all("raised" in flags and "head_out_of_reach" not in flags for flags in result.flags[top])
    assert np.abs(result.joints[top][:, list(FEET), 1] - sole - 1.0).max() < 0.12
    heads = np.array([s.head[1] for s in samples if s.head is not None])
    ours = result.joints[:, HEAD, 1] - result.joints[0, HEAD, 1]
    assert np.abs(ours - (heads - heads[0]))[top].max() < 0.01
    assert max(e for reach in result.reach[top] for e in reach if e is not None) < 0.005
    assert "raised" not in result.flags[-1] and result.joints[-1, list(FEET), 1].max() < sole + 0.02
    assert np.abs(np.diff(result.joints[:, list(FEET), 1], axis=0)).max() * 72 < 8.0  # m/s: as of a step


@EACH
@pytest.mark.parametrize("taller", [0.15, 0.4])
def test_a_taller_user_stands_on_the_floor(stage: Stage, track: Track, solver: SolverName, taller: float) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(t, head=(x, y + taller, z), left=None, right=None) for t in seconds(4)], solver=solver)
    assert "raised" not in result.flags[-1] and "head_out_of_reach" in result.flags[-1]
    assert result.joints[-1, list(FEET), 1].max() < stage.body.sole + 0.02


RAW = TrackerConfig.raw()
STIFF = TrackerConfig(arm_scaling=0.0)


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


@pytest.mark.parametrize("share", [-0.1, 1.5, float("nan")])
def test_an_arm_scaling_out_of_range_is_refused(share: float) -> None:
    with pytest.raises(PoseError, match="arm_scaling needs 0 to 1"):
        TrackerConfig(arm_scaling=share)


def test_a_new_user_begins_with_arms_at_rest(stage: Stage, skeleton: Skeleton) -> None:
    tracker = Tracker(skeleton, config=RAW)
    tracker.update(stage.sample(0.0, left=reaching(stage, 1.15)))
    tracker.reset()
    assert tracker.update(stage.sample(1.0)).translations is None


def test_a_new_user_begins_on_the_floor(stage: Stage, skeleton: Skeleton) -> None:
    tracker = Tracker(skeleton, solver="analytic")
    for sample in climbing(stage, 1.0, down=False)[:360]:
        tracker.update(sample)
    assert "raised" in tracker.flags
    tracker.reset()
    joints = tracker.joints(tracker.update(stage.sample(0.0)))
    assert "raised" not in tracker.flags and joints[list(FEET), 1].max() < stage.body.sole + 0.1


def test_any_gap_gives_finite_metres(body: Body) -> None:
    expected = ExpectedError(body.eye_height)
    for gap in (0.0, 1e-9, 1e3, 1e30):
        out = expected.update(Targets((0.0, 1e6, 0.0), (1.0, 0.0, 0.0, 0.0)), gap, 1e-4)
        assert np.isfinite(out).all() and 0 <= min(out) and max(out) <= MAX_ERROR_M * expected.size + 1e-9
