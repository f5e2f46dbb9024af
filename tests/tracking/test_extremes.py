"""Stiff and extreme input: what is promised for each, over and above finite, inside the limits and rate-limited."""

from __future__ import annotations

import math

import numpy as np
import pytest

from glsplat.tracking import Calibration, Sample
from glsplat.tracking.solve.body import ANKLES, ELBOWS, FEET, HEAD, SHOULDERS, WRISTS
from tests.tracking.moves import DT, Run, Stage, Track, hand_turn, head_turn, seconds

NAN = math.nan
LEARNED = pytest.mark.extra(name="learned")


def settled(result: Run, last: int = 15) -> bool:
    """Nothing moves any more."""
    return bool(np.abs(np.diff(result.joints[-last:], axis=0)).max() < 2e-3)


def test_hands_out_of_reach_straighten_the_arms_towards_them(stage: Stage, track: Track) -> None:
    left, right = (2.0, 1.2, 2.0), (-2.0, 1.5, 2.0)
    result = track([stage.sample(t, left=left, right=right) for t in seconds(1)])
    assert result.flags[-1].count("left_out_of_reach") == 1 and "right_out_of_reach" in result.flags[-1]
    for side, target in enumerate((left, right)):
        shoulder, elbow, wrist = (result.joints[-1, pair[side]] for pair in (SHOULDERS, ELBOWS, WRISTS))
        upper, lower = elbow - shoulder, wrist - elbow
        assert upper @ lower > 0.999 * np.linalg.norm(upper) * np.linalg.norm(lower)  # straight
        aim = np.array(target) - shoulder
        assert (wrist - shoulder) @ aim > 0.995 * np.linalg.norm(wrist - shoulder) * np.linalg.norm(aim)
        assert result.reach[-1][side] == pytest.approx(np.linalg.norm(np.array(target) - wrist), abs=1e-6)


def test_a_hand_that_leaves_its_reach_and_returns_does_not_flip_the_elbow(stage: Stage, track: Track) -> None:
    samples = []
    for t in seconds(4):
        far = 0.45 + 0.35 * math.sin(t * 1.6)
        samples.append(stage.sample(t, left=(0.2, 1.35, 0.15 + far), left_turn=hand_turn("left", (0.0, -1.5, 0.0))))
    result = track(samples)
    elbow = result.joints[:, ELBOWS[0]]
    assert np.linalg.norm(np.diff(elbow, axis=0), axis=1).max() / DT < 6  # m/s; a flip would be tens
    assert elbow[:, 1].max() < result.joints[:, SHOULDERS[0], 1].max() + 0.03  # never above the shoulder


def test_both_hands_behind_the_back(stage: Stage, track: Track) -> None:
    turns = {"left_turn": hand_turn("left", (0.0, 2.8, 0.0)), "right_turn": hand_turn("right", (0.0, -2.8, 0.0))}
    hands = {"left": (0.05, 0.61 * stage.body.eye_height, -0.2), "right": (-0.05, 0.61 * stage.body.eye_height, -0.2)}
    result = track([stage.sample(t, **hands, **turns) for t in seconds(1.5)])
    assert max(e for e in result.reach[-1] if e is not None) < 0.03
    assert (result.joints[-1, list(ELBOWS), 2] < result.joints[-1, list(SHOULDERS), 2] + 0.05).all()
    assert settled(result)


def test_hands_that_swap_places_cross_without_a_jump(stage: Stage, track: Track) -> None:
    def sample(t: float) -> Sample:
        left, right = stage.hand("left", z=0.3), stage.hand("right", z=0.3)
        return stage.sample(t, left=left, right=right) if t < 1 else stage.sample(t, left=right, right=left)

    result = track([sample(t) for t in seconds(2.5)])
    moved = np.linalg.norm(np.diff(result.joints[:, list(WRISTS)], axis=0), axis=-1)
    assert moved.max() / DT < 40
    assert max(e for e in result.reach[-1] if e is not None) < 0.1  # arms cross
    assert settled(result)


@pytest.mark.parametrize("place", [(0.0, 0.68, 0.0), (0.17, 0.83, 0.02), (0.02, 0.9, 0.1)])
def test_a_hand_inside_the_body_folds_the_arm(stage: Stage, track: Track, place: tuple[float, float, float]) -> None:
    hand = (place[0], place[1] * stage.body.eye_height, place[2])
    result = track([stage.sample(t, left=hand) for t in seconds(2.5)])
    assert settled(result)
    upper = result.joints[-1, ELBOWS[0]] - result.joints[-1, SHOULDERS[0]]
    assert np.linalg.norm(upper) > 0.2  # no bone is squeezed


def test_head_three_metres_up_is_a_jump_that_ends(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    samples = [stage.sample(t, head=(x, min(y + 2 * t, 3.0), z), left=None, right=None) for t in seconds(4)]
    result = track(samples)
    assert any("airborne" in flags for flags in result.flags)
    assert "head_out_of_reach" in result.flags[-1] and "left_planted" in result.flags[-1]
    assert result.joints[-1, list(FEET), 1].max() < stage.body.sole + 0.01  # back on the floor


def test_a_real_jump_leaves_the_floor_and_lands(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye

    def height(t: float) -> float:  # crouch, fly for 0.5 s, land
        flight = t - 1.0
        return y + (max(0.0, 2.45 * flight - 4.9 * flight**2) if 0 < flight < 0.5 else 0.0)

    result = track([stage.sample(t, head=(x, height(t), z)) for t in seconds(2.5)])
    soles = result.joints[:, list(FEET), 1].min(1) - stage.body.sole
    assert soles.max() > 0.08 and soles[:60].max() < 0.01 and soles[-20:].max() < 0.01
    assert "head_out_of_reach" not in result.flags[-1]


def test_head_on_the_floor(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    for lowest in (0.05, -1.0):  # below the floor counts as on it
        samples = [stage.sample(t, head=(x, max(lowest, y - 1.2 * t), z), left=None, right=None) for t in seconds(3)]
        result = track(samples)
        assert settled(result)
        assert result.joints[-1, :22, 1].min() > -0.05  # nothing sinks into the floor
        assert result.joints[-1, 0, 1] > 0.15  # the pelvis neither


@pytest.mark.parametrize("pitch", [-math.pi / 2, math.pi / 2])
def test_looking_straight_up_or_down_for_seconds_does_not_spin_the_body(
    stage: Stage, track: Track, pitch: float
) -> None:
    samples = []
    for t in seconds(4):  # with the trembling of a real head
        shake = 0.01 * math.sin(40 * t)
        samples.append(stage.sample(t, turn=head_turn(shake, pitch * min(1.0, 2 * t), 0.01 * math.cos(37 * t))))
    result = track(samples)
    across = result.joints[:, 1] - result.joints[:, 2]
    heading = np.degrees(np.arctan2(-across[:, 2], across[:, 0]))
    assert np.abs(heading).max() < 12


def test_upside_down_keeps_the_last_heading(stage: Stage, track: Track) -> None:
    result = track([stage.sample(t, turn=head_turn(0.0, math.pi * min(1.0, t))) for t in seconds(4)])
    across = result.joints[-1, 1] - result.joints[-1, 2]
    assert abs(math.degrees(math.atan2(-across[2], across[0]))) < 15
    assert "head_limit" in result.flags[-1] and settled(result)


@pytest.mark.parametrize("direction", [1, -1])
def test_full_turns_are_followed_and_unwound(stage: Stage, track: Track, direction: int) -> None:
    rate = direction * 2 * math.pi / 3
    samples = []
    for t in seconds(6):
        s, c = math.sin(rate * t), math.cos(rate * t)
        head = (0.13 * s, stage.body.eye_height, 0.13 * c)
        hand = stage.hand("left")
        places = {
            side: (sign * hand[0] * c + hand[2] * s, hand[1], -sign * hand[0] * s + hand[2] * c)
            for side, sign in (("left", 1), ("right", -1))
        }
        turn = {f"{side}_turn": _turned(hand_turn(side, (0, 0, -1.2 * sign)), rate * t) for side, sign in _SIDES}
        samples.append(stage.sample(t, head=head, turn=head_turn(rate * t), **places, **turn))
    result = track(samples)
    across = result.joints[:, SHOULDERS[0]] - result.joints[:, SHOULDERS[1]]
    heading = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
    assert heading[-1] - heading[0] == pytest.approx(rate * result.times[-1], abs=0.8)
    assert max(e for pair in result.reach[60:] for e in pair if e is not None) < 0.08


_SIDES = (("left", 1), ("right", -1))


def _turned(xyzw: tuple[float, ...], yaw: float) -> tuple[float, ...]:
    from glsplat.tracking.solve.quat import mul, yaw_quat

    w, x, y, z = mul(yaw_quat(yaw), (xyzw[3], xyzw[0], xyzw[1], xyzw[2]))
    return (x, y, z, w)


def test_a_lost_hand_is_held_then_sinks_and_is_taken_up_smoothly(stage: Stage, track: Track) -> None:
    up = (0.3, 0.8 * stage.body.eye_height, 0.4)
    samples = [stage.sample(t, left=None if 1 < t < 3 else up) for t in seconds(4)]
    result = track(samples, fastest=20.0)
    wrist = result.joints[:, WRISTS[0]]
    at = lambda t: wrist[int(t / DT)]  # noqa: E731
    np.testing.assert_allclose(at(1.2), up, atol=0.03)  # held
    assert at(2.9)[1] < 0.65 * stage.body.eye_height  # hanging
    np.testing.assert_allclose(at(3.9), up, atol=0.01)  # back
    assert np.linalg.norm(np.diff(wrist, axis=0), axis=1).max() / DT < 8
    assert "left_lost" in result.flags[int(2 / DT)] and result.reach[int(2 / DT)][0] is None


def test_everything_lost_holds_the_body(stage: Stage, track: Track) -> None:
    result = track([stage.sample(t) if t < 1 else Sample(t) for t in seconds(4)])
    assert {"head_lost", "left_lost", "right_lost"} <= set(result.flags[-1])
    np.testing.assert_allclose(result.joints[-1, HEAD], result.joints[60, HEAD], atol=0.01)
    assert settled(result)


@pytest.mark.parametrize(("solver", "off"), [("analytic", 1e-6), pytest.param("learned", 0.01, marks=LEARNED)])
def test_nothing_ever_tracked_stands_at_the_origin(stage: Stage, track: Track, solver: str, off: float) -> None:
    result = track([Sample(t) for t in seconds(0.5)], solver=solver)
    assert abs(result.joints[-1, 0, 0]) < off and result.joints[-1, list(ANKLES), 1].max() < 0.15


def test_a_teleport_is_declared_and_taken_at_once(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(t, head=(x + (5 if t > 1 else 0), y, z), left=None, right=None) for t in seconds(2)])
    declared = [i for i, flags in enumerate(result.flags) if "teleport" in flags]
    assert len(declared) == 1
    assert result.joints[declared[0], HEAD, 0] == pytest.approx(5, abs=0.1)
    assert result.joints[declared[0], list(FEET), 0].mean() == pytest.approx(5, abs=0.2)


def test_frozen_samples_are_flagged_and_still(stage: Stage, track: Track) -> None:
    result = track([stage.sample(t, left=stage.hand("left", y=0.7)) for t in seconds(2)])
    assert "frozen" in result.flags[-1] and settled(result)


@pytest.mark.parametrize(
    "times",
    [
        [0.0, DT, DT, DT, 2 * DT, 2 * DT, 3 * DT],
        [0.0, DT, 0.5 * DT, 2 * DT, 0.0, 3 * DT],
        [0.0, 1e-6, 2e-6, 3e-6, DT],
        [0.0, NAN, DT, math.inf, 2 * DT, -math.inf],
    ],
    ids=["repeated", "decreasing", "1us", "not finite"],
)
def test_samples_that_do_not_advance_do_not_move_the_body(stage: Stage, track: Track, times: list[float]) -> None:
    samples = [stage.sample(t, left=stage.hand("left", y=0.6 + 0.05 * i)) for i, t in enumerate(times)]
    result = track(samples)
    latest = -math.inf
    for i, t in enumerate(times):
        if not math.isfinite(t) or t - latest < 1e-4:
            assert any(flag.startswith("time_") for flag in result.flags[i])
            np.testing.assert_array_equal(result.rotations[i], result.rotations[i - 1])
        else:
            latest = t


def test_a_clock_set_back_is_accepted(stage: Stage, track: Track) -> None:
    times = [*seconds(1.5), *seconds(1.5)]
    result = track([stage.sample(t, left=stage.hand("left", y=0.6 + 0.1 * t)) for t in times])
    assert "clock" in result.flags[108] and "clock" not in result.flags[-1]
    assert np.abs(result.rotations[120] - result.rotations[119]).max() > 0  # and it goes on


def test_ten_seconds_without_samples_start_anew(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(10.0 * i, head=(x + 0.3 * i, y, z), left=None, right=None) for i in range(5)])
    assert all("gap" in flags for flags in result.flags[1:])
    np.testing.assert_allclose(result.joints[:, list(FEET), 0].mean(1), 0.3 * np.arange(5), atol=0.1)


@pytest.mark.parametrize(("solver", "off"), [("analytic", 0.03), pytest.param("learned", 0.04, marks=LEARNED)])
def test_nan_and_infinity_are_a_lost_device(stage: Stage, track: Track, solver: str, off: float) -> None:
    good = [stage.sample(t) for t in seconds(1)]
    bad = []
    for i, t in enumerate(seconds(1)):
        head = (NAN, 1.0, 0.0) if i % 5 == 4 else None
        left = (math.inf, 0.0, 0.0) if i % 7 == 6 else "rest"
        turn = (NAN,) * 4 if i % 4 == 3 else None
        joints = [(NAN, NAN, NAN)] * 25 if i % 3 == 0 else None
        bad.append(stage.sample(t, head=head, left=left, right_turn=turn, left_joints=joints, right_curl=NAN))
    clean, dirty = track(good, solver=solver), track(bad, solver=solver)
    assert "head_lost" in dirty.flags[4] and "left_lost" in dirty.flags[6] and "right_lost" in dirty.flags[3]
    np.testing.assert_allclose(dirty.joints[:, :22], clean.joints[:, :22], atol=off)


def test_quaternions_of_any_length_and_sign_mean_the_same(stage: Stage, track: Track) -> None:
    turn, hand = head_turn(0.2, 0.1), hand_turn("left", (0.1, 0.2, -1.0))
    plain = track([stage.sample(t, turn=turn, left_turn=hand) for t in seconds(0.5)])
    odd = []
    for i, t in enumerate(seconds(0.5)):
        k = (-1) ** i * (0.01 + i)
        odd.append(stage.sample(t, turn=tuple(v * k for v in turn), left_turn=tuple(-v * k for v in hand)))
    np.testing.assert_allclose(track(odd).joints, plain.joints, atol=1e-9)
    zero = track([stage.sample(t, left_turn=(0.0, 0.0, 0.0, 0.0)) for t in seconds(0.2)])
    assert "left_lost" in zero.flags[-1]


@pytest.mark.parametrize("height", [1.2, 2.1])
def test_small_and_tall_users(stage: Stage, track: Track, height: float) -> None:
    eyes = 0.936 * height
    calibration = Calibration.of_height(track([Sample(0.0)]).tracker.skeleton, height)
    hands = {"left": (0.14 * height, 0.6 * eyes, 0.1), "right": (-0.14 * height, 0.6 * eyes, 0.1)}
    fitted = track([stage.sample(t, head=(0, eyes, 0.1), **hands) for t in seconds(1)], calibration=calibration)
    assert fitted.tracker.calibration.scale == pytest.approx(eyes / stage.body.eye_height)
    assert np.abs(fitted.joints[-1, 4:6, 2] - fitted.joints[-1, 1:3, 2]).max() < 0.1 * height  # knees not bent
    assert fitted.joints[-1, HEAD, 1] == pytest.approx(eyes, abs=0.06 * height)
    assert max(e for e in fitted.reach[-1] if e is not None) < 0.02
    plain = track([stage.sample(t, head=(0, eyes, 0.1), left=None, right=None) for t in seconds(3)])
    assert "left_planted" in plain.flags[-1]  # uncalibrated: crouched, or below the user's head, but on the floor


def test_noise_of_every_kind_at_once(stage: Stage, track: Track, rng: np.random.Generator) -> None:
    samples, t = [], 0.0
    for _ in range(400):
        t += float(rng.choice([0.0, 1e-6, 0.002, DT, 0.05, 0.3, 10.0, -0.02]))
        values = rng.normal(0, 1, (5, 4))
        left = None if rng.random() < 0.2 else tuple(values[2, :3])
        hands = {"left": left, "right": tuple(values[3, :3] * 3), "left_turn": tuple(values[4])}
        samples.append(stage.sample(t, head=tuple(values[0, :3]), turn=tuple(values[1]), **hands))
    track(samples)


@pytest.mark.parametrize("solver", ["analytic", pytest.param("learned", marks=LEARNED)])
def test_the_same_samples_give_the_same_bytes(
    stage: Stage, track: Track, rng: np.random.Generator, solver: str
) -> None:
    samples = [stage.sample(t, left=tuple(rng.normal(0, 0.1, 3) + (0.2, 1.2, 0.3))) for t in seconds(1)]
    one, two = (track(samples, solver=solver) for _ in range(2))
    assert one.rotations.tobytes() == two.rotations.tobytes() and one.trans.tobytes() == two.trans.tobytes()
    again = one.tracker
    again.reset()
    for sample, rotations in zip(samples[:20], one.rotations, strict=False):
        assert again.update(sample).rotations[:22].tobytes() == rotations[:22].tobytes()


def test_holes_of_some_tenths_are_bridged(stage: Stage, track: Track) -> None:
    samples = [stage.sample(0.3 * i, left=stage.hand("left", y=0.68 + 0.05 * math.sin(i))) for i in range(40)]
    result = track(samples)
    assert not any(set(flags) & {"gap", "teleport"} for flags in result.flags)
    assert max(pair[0] for pair in result.reach[1:] if pair[0] is not None) < 0.02


def test_a_small_jump_of_the_head_is_not_a_teleport(stage: Stage, track: Track) -> None:
    x, y, z = stage.eye
    result = track([stage.sample(t, head=(x + (0.5 if t > 1 else 0), y, z), left=None, right=None) for t in seconds(3)])
    assert not any("teleport" in flags for flags in result.flags)
    assert np.linalg.norm(np.diff(result.trans, axis=0), axis=1).max() / DT < 15
    assert result.joints[-1, list(FEET), 0].mean() == pytest.approx(0.5, abs=0.12)  # it stepped after it
