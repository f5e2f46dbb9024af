"""What the analytic solver does with ordinary movements: reach, lean, crouch, turn, walk, stand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Sample, Tracker, TrackerConfig
from glsplat.tracking.solve.body import ELBOWS, FEET, HEAD, KNEES, SHOULDERS, WRISTS, Body
from glsplat.tracking.solve.solver import SLOW_SMOOTHING_S, AnalyticSolver
from tests.tracking.moves import DT, Run, Stage, Track, hand_turn, head_turn, seconds


def heading(result: Run) -> np.ndarray:
    across = result.joints[:, 1] - result.joints[:, 2]
    return np.degrees(np.unwrap(np.arctan2(-across[:, 2], across[:, 0])))


def slides(result: Run) -> np.ndarray:
    """Metres each sample that a foot moved while both samples call it planted."""
    moved = np.linalg.norm(np.diff(result.joints[:, list(FEET)], axis=0), axis=-1)
    for i, side in enumerate(("left_planted", "right_planted")):
        planted = np.array([side in flags for flags in result.flags])
        moved[~(planted[1:] & planted[:-1]), i] = 0
    return moved


def test_elbows_hang_down_and_out(stage: Stage, track: Track) -> None:
    hands = {side: (x, 0.75 * stage.body.eye_height, 0.3) for side, x in (("left", 0.2), ("right", -0.2))}
    forward = {"left_turn": hand_turn("left", (0, -1.4, 0)), "right_turn": hand_turn("right", (0, 1.4, 0))}
    result = track([stage.sample(t, **hands, **forward) for t in seconds(0.5)])
    for side, sign in ((0, 1), (1, -1)):
        elbow, shoulder = result.joints[-1, ELBOWS[side]], result.joints[-1, SHOULDERS[side]]
        assert elbow[1] < shoulder[1] - 0.1 and sign * elbow[0] > 0.1


def test_a_crouch_bends_the_knees_with_the_feet_on_the_floor(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(t, head=(x, y - 0.4 * min(1.0, t), z)) for t in seconds(2)])
    knees = np.degrees(np.linalg.norm(result.rotations[-1, list(KNEES)], axis=1))
    assert knees.min() > 50
    assert slides(result).max() < 1e-4
    soles = result.joints[-1, list(FEET), 1] - stage.body.sole
    assert np.abs(soles).max() < 0.01


def test_a_bow_bends_the_torso_and_keeps_the_pelvis_over_the_feet(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    bow = []
    for t in seconds(1.5):
        part = min(1.0, t)
        bow.append(stage.sample(t, head=(x, y - 0.3 * part, z + 0.45 * part), turn=head_turn(0.0, part)))
    result = track(bow)
    torso = result.joints[-1, 12] - result.joints[-1, 0]
    assert math.degrees(math.atan2(torso[2], torso[1])) > 18
    assert abs(result.joints[-1, 0, 2]) < 0.2


def test_looking_aside_does_not_turn_the_feet_but_staying_aside_does(stage: Stage, track: Track) -> None:
    glance = [stage.sample(t, turn=head_turn(0.9 if 1 < t < 1.4 else 0.0)) for t in seconds(3)]
    turned = heading(track(glance))
    assert np.abs(turned).max() < 25 and abs(turned[-1]) < 12
    stay = [Sample(t, (*stage.eye, *head_turn(1.4 * min(1.0, t)))) for t in seconds(6)]
    assert heading(track(stay))[-1] > 45


@pytest.mark.parametrize("speed", [0.7, 1.3, 3.0])
def test_walking_and_running_step_and_never_slide(stage: Stage, track: Track, speed: float) -> None:
    x, y, z = stage.eye
    cadence = 2.6 if speed > 2 else 0.9 + 0.75 * speed  # steps a second
    samples = []
    for t in seconds(6):
        swing = 0.22 * math.sin(math.pi * cadence * t)
        forward = z + speed * t
        bob = 0.02 * math.cos(2 * math.pi * cadence * t)
        hands = {"left": (0.25, 1.0, forward - 0.1 + swing), "right": (-0.25, 1.0, forward - 0.1 - swing)}
        samples.append(stage.sample(t, head=(x, y - 0.03 + bob, forward), **hands))
    result = track(samples)
    feet = result.joints[:, list(FEET)]
    assert slides(result)[72:].max() < 0.012  # metres a sample
    assert slides(result)[72:].mean() / DT < 0.01  # m/s
    lifted = feet[72:, :, 1] > stage.body.sole + 0.02
    steps = (np.diff(lifted.astype(int), axis=0) == 1).sum(0) / (6 - 1)
    assert steps == pytest.approx([cadence / 2] * 2, rel=0.25)  # each foot, a second
    assert feet[-1, :, 2].mean() == pytest.approx(result.joints[-1, 0, 2], abs=0.45)
    assert feet[..., 1].min() > stage.body.sole - 0.005
    assert np.abs(heading(result)).max() < 15


def test_steps_of_head_and_hand_overshoot_little(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    first, second = (0.25, 1.2, 0.3), (0.25, 1.45, 0.35)
    turn = {"left_turn": hand_turn("left", (0, -1.4, 0))}
    hand = track([stage.sample(t, left=first if t < 1 else second, **turn) for t in seconds(2)])
    height = hand.joints[:, WRISTS[0], 1]
    assert height.max() < second[1] + 0.005 and height[-1] == pytest.approx(second[1], abs=0.003)
    shifted = track([stage.sample(t, head=(x, y - (0.2 if t > 1 else 0), z)) for t in seconds(3)])
    pelvis = shifted.joints[:, 0, 1]
    assert pelvis.min() > pelvis[-1] - 0.06  # 6 cm while the bend follows
    assert shifted.joints[:, HEAD, 1].min() > shifted.joints[-1, HEAD, 1] - 0.02


@pytest.mark.parametrize("rate", [30.0, 72.0, 90.0, 240.0])
def test_the_slow_speed_lags_by_its_time_constant(body: Body, rate: float) -> None:
    """The mean delay of a first-order low pass is its time constant, whatever the rate; here behind the travel."""
    solver, dt = AnalyticSolver(body), 1 / rate
    lag = at = 0.0
    for step in range(round(8 * rate)):
        at += dt * (step > 3 * rate)  # stands, then goes at 1 m/s
        solver._update_motion((at, 0.0, 0.0), dt)
        lag += (solver._travel[0] - solver._slow[0]) * dt
    assert solver._slow[0] == pytest.approx(1, abs=1e-6)
    assert SLOW_SMOOTHING_S == 0.125 and lag == pytest.approx(SLOW_SMOOTHING_S, abs=0.6 * dt)


def test_prediction_moves_the_pose_ahead(stage: Stage, skeleton: Skeleton) -> None:
    late, early = Tracker(skeleton), Tracker(skeleton, config=TrackerConfig(prediction=0.05))
    for t in seconds(1):
        sample = stage.sample(t, head=(0.5 * t, *stage.eye[1:]), left=None, right=None)
        a, b = late.joints(late.update(sample)), early.joints(early.update(sample))
    assert b[HEAD, 0] - a[HEAD, 0] == pytest.approx(0.025, abs=0.005)


def test_walking_backwards_and_sideways_does_not_turn_round(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    for dx, dz in ((0.0, -0.8), (0.8, 0.0)):
        samples = [stage.sample(t, head=(x + dx * t, y, z + dz * t), left=None, right=None) for t in seconds(3)]
        assert np.abs(heading(track(samples))).max() < 20


def test_a_wire_request_drives_the_tracker(stage: Stage, skeleton: Skeleton) -> None:
    wire = stage.sample(0.0).to_json()
    direct = Tracker(skeleton).update(stage.sample(0.0)).rotations
    np.testing.assert_array_equal(Tracker(skeleton)(wire, 12345.0).rotations, direct)
