"""A user's size: calibrated, told, or found while the session runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Calibration, Sample, Tracker, calibrate
from glsplat.tracking.body_size import POSTURE, BodySizeFinder
from glsplat.tracking.calibration import found_size
from glsplat.tracking.solve.body import FEET, TURNS_AT, WRISTS, Body
from glsplat.tracking.solve.quat import rotate, sub, to_quat
from glsplat.tracking.solvers import SolverName
from tests.tracking.moves import Stage, Track, head_turn, seconds


def standing(stage: Stage, scale: float, floor: float = 0.0, pitch: float = 0.0, arms: bool = False) -> list[Sample]:
    rng = np.random.default_rng(1)
    span = float(stage.body.rest[WRISTS[0], 0]) * scale
    samples = []
    for t in seconds(2):
        shake = rng.normal(0, 0.002, 3)
        head = (shake[0], floor + scale * stage.body.eye_height + shake[1], shake[2])
        hands = {"left": (span, 1.4, 0.0), "right": (-span, 1.4, 0.0)} if arms else {}
        samples.append(stage.sample(t, head=head, turn=head_turn(0.0, pitch), **hands))
    return samples


@pytest.mark.parametrize("scale", [0.65, 1.0, 1.2])
def test_scale_from_the_eyes(stage: Stage, skeleton: Skeleton, scale: float) -> None:
    found = calibrate(standing(stage, scale), skeleton)
    assert found.scale == pytest.approx(scale, abs=0.003)
    assert found.eye_height == pytest.approx(scale * stage.body.eye_height, abs=0.003)
    assert found.arm_span is None  # the arms hung


def test_long_arms_raise_the_scale_a_little(stage: Stage, skeleton: Skeleton) -> None:
    samples = standing(stage, 1.0)
    wide = [Sample(s.t, s.head, (0.8, 1.4, 0, 0, 0, 0, 1), (-0.8, 1.4, 0, 0, 0, 0, 1)) for s in samples]
    found = calibrate(wide, skeleton)
    ratio = 1.6 / stage.body.arm_span()
    assert found.arm_span == pytest.approx(1.6) and 1 < found.scale < ratio
    assert calibrate(standing(stage, 1.1, arms=True), skeleton).scale == pytest.approx(1.1, abs=0.003)


def test_a_hand_that_waves_while_the_other_hangs_is_no_arm_span(stage: Stage, skeleton: Skeleton) -> None:
    """Both are as far apart as stretched arms; avatars with short arms once stood on tiptoe because of it."""
    samples = standing(stage, 1.0)
    far = 0.95 * stage.body.arm_span()
    down, up = 0.55 * stage.body.eye_height, 1.03 * stage.body.eye_height
    across = float(np.sqrt(far**2 - (up - down) ** 2)) / 2
    hands = (across, down, 0, 0, 0, 0, 1), (-across, up, 0, 0, 0, 0, 1)
    found = calibrate([Sample(s.t, s.head, *hands) for s in samples], skeleton)
    assert found.arm_span is None and found.scale == pytest.approx(1, abs=0.003)


@pytest.mark.parametrize("height", [1.5, 1.75])
def test_a_told_arm_span_counts_as_a_measured_one(stage: Stage, skeleton: Skeleton, height: float) -> None:
    plain = Calibration.of_height(skeleton, height)
    samples = standing(stage, plain.scale)
    for factor in (0.5, 0.86, 1.0, 1.15, 1.4):
        span = factor * plain.scale * stage.body.arm_span()
        hands = [(side * span / 2, 1.4, 0, 0, 0, 0, 1) for side in (1, -1)]
        measured = calibrate([Sample(s.t, s.head, *hands) for s in samples], skeleton)
        told = plain.with_span(skeleton, span)
        assert told.scale == pytest.approx(measured.scale, abs=0.003)
        assert (told.arm_span is None) == (factor in (0.5, 1.4))  # those are no stretched arms


def test_floor_and_pitch(stage: Stage, skeleton: Skeleton) -> None:
    samples = standing(stage, 1.0, floor=0.4, pitch=0.15)
    by_floor = calibrate(samples, skeleton, floor=0.4)
    assert by_floor.scale == pytest.approx(1, abs=0.003) and by_floor.head_pitch == pytest.approx(0.15, abs=0.01)
    by_height = calibrate(samples, skeleton, height=stage.body.eye_height / 0.936)
    assert by_height.floor == pytest.approx(0.4, abs=0.003) and by_height.scale == pytest.approx(1, abs=0.003)
    tracker = Tracker(skeleton, by_floor)
    for sample in samples:
        pose = tracker.update(sample)
    joints = tracker.joints(pose)
    assert joints[10:12, 1].min() == pytest.approx(0.4 + stage.body.sole, abs=0.01)
    head = skeleton.forward(pose.rotations, pose.trans)[15, :3, :3]
    assert abs(head[1, 2]) < 0.03  # it looks ahead although the headset points down
    eye = np.eye(4)
    eye[:3, 3] = (0, 0.4 + 1.0, 0)
    np.testing.assert_allclose(tracker.to_avatar(eye)[:3, 3], (0, 1.0 / by_floor.scale, 0), atol=1e-9)


def test_the_avatar_scale_is_limited(skeleton: Skeleton) -> None:
    assert Calibration.of_height(skeleton, 0.6).scale == 0.5
    with pytest.raises(PoseError):
        Calibration.of_height(skeleton, 3.5)
    with pytest.raises(PoseError):
        Calibration(scale=3.0)


@pytest.mark.parametrize("problem", ["few", "moving", "lying"])
def test_bad_calibrations_say_why(stage: Stage, skeleton: Skeleton, problem: str) -> None:
    samples = standing(stage, 1.0)
    if problem == "few":
        samples = samples[:5]
    elif problem == "moving":
        samples = [stage.sample(t, head=(t, 1.7, 0.0)) for t in seconds(2)]
    else:
        samples = [stage.sample(t, head=(0.0, 0.2, 0.0)) for t in seconds(2)]
    with pytest.raises(PoseError, match=r"10 samples|moved|above the floor"):
        calibrate(samples, skeleton)


def test_file_round_trip_and_errors(tmp_path: Path, skeleton: Skeleton) -> None:
    path = tmp_path / "me.json"
    made = Calibration(scale=1.05, floor=-0.1, head_pitch=0.1, eye_height=1.6)
    made.save(path)
    assert Calibration.load(path) == made and json.loads(path.read_text())["scale"] == 1.05
    Calibration(scale=0.9, automatic=True).save(path)
    assert Calibration.load(path) == Calibration(scale=0.9, automatic=True)
    broken = ["[]", "[1]", "{", "{}", '{"floor": 0}', '{"scale": 1, "automatic": 1}', '{"scale": 1, "found": 7}']
    for text in (*broken, *(f'{{"scale": {value}}}' for value in ('"tall"', '"1"', "9", "true", "null"))):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"me\.json"):
            Calibration.load(path)
    with pytest.raises(FormatError, match="missing"):
        Calibration.load(tmp_path / "missing.json")


@pytest.mark.extra(name="rigs")
def test_other_rigs_are_refused(skeleton: Skeleton) -> None:
    with pytest.raises(PoseError, match="no joint for head, left_hip"):
        Body.of(Skeleton.from_joints(("a", "b"), [-1, 0], [[0, 0, 0], [0, 1, 0]]))
    twisted = skeleton.rest.copy()
    twisted[3, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    with pytest.raises(PoseError, match="parallel"):
        Body.of(Skeleton(skeleton.names, skeleton.parents, twisted))


RATE = 30


def scales(body: Body, size: float, low: float, begins: float, hangs: bool = True, bow: float = 0.0) -> list[float]:
    """Of somebody ``size`` times the avatar who is ``low`` of that lower for ``begins`` seconds, then stands for 10."""
    finder, out = BodySizeFinder(body, 1.0), []
    rng = np.random.default_rng(2)
    turn = to_quat((bow, 0.0, 0.0))
    bowed = sub(TURNS_AT, rotate(turn, TURNS_AT))
    for t in seconds(begins + 10, 1 / RATE):
        down = low * min(max((begins - t) / 0.8, 0.0), 1.0)
        height = (POSTURE - down) * size * body.eye_height + rng.normal(0, 0.003) + bowed[1]
        eye = (0.02 * np.sin(t), height, 0.1)
        wrist = (0.2, height * (0.54 if hangs and not down else 0.75), 0.15 if hangs else 0.4)
        out.append(finder.update(eye, turn, [wrist], 1 / RATE))
    return out


@pytest.mark.parametrize("size", [0.8, 0.9, 1.0, 1.1])
@pytest.mark.parametrize(("low", "begins"), [(0.0, 0.0), (0.25, 4.0), (0.2, 4.0)], ids=["stands", "sits", "crouches"])
def test_a_size_is_found_within_ten_seconds_of_standing(body: Body, size: float, low: float, begins: float) -> None:
    of_time = scales(body, size, low, begins)
    assert of_time[-1] == pytest.approx(size, rel=0.03)
    assert abs(of_time[90] / size - 1) < abs(1 / size - 1) + 0.01  # after 3 s no worse than without
    assert np.abs(np.diff(of_time)).max() * RATE < 0.16  # a second; nothing jerks
    assert np.abs(np.diff(of_time, 2)).max() < 2e-3


def test_a_head_that_is_bowed_is_no_smaller_person(body: Body) -> None:
    assert scales(body, 0.9, 0.0, 0.0, bow=0.8)[-1] == pytest.approx(scales(body, 0.9, 0.0, 0.0)[-1], abs=0.01)


def test_who_may_sit_on_a_chair_stays_as_large_as_the_avatar(body: Body) -> None:
    low = 0.74 * body.eye_height  # 1.28 m, hands ahead of the chest, for half a minute
    finder = BodySizeFinder(body, 1.0)
    for _ in range(30 * RATE):
        scale = finder.update((0.0, low, 0.0), (1.0, 0.0, 0.0, 0.0), [(0.2, low - 0.35, 0.3)], 1 / RATE)
    assert scale == 1.0
    for step in range(3 * RATE):  # whoever walks at that height stands
        scale = finder.update((step / RATE, low, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)
    assert scale < 0.85


def test_arms_that_were_stretched_count_a_quarter(stage: Stage) -> None:
    body, size, long = stage.body, 0.9, 1.1
    finder = BodySizeFinder(body, 1.0)
    span = long * size * body.arm_span()
    eyes = POSTURE * size * body.eye_height
    for _ in range(10 * RATE):
        hands = [(side * span / 2, 0.85 * eyes, 0.0) for side in (1, -1)]
        scale = finder.update((0.0, eyes, 0.1), (1.0, 0.0, 0.0, 0.0), hands, 1 / RATE)
    assert scale == pytest.approx(size * (0.75 + 0.25 * long), rel=0.02)
    assert finder.arm_span == pytest.approx(span, abs=0.02)
    for _ in range(6 * RATE):  # a quarter, also where nothing new is believed
        finder.update((0.0, 0.7 * eyes, 0.1), (1.0, 0.0, 0.0, 0.0), [(0.2, 0.4 * eyes, 0.3)], 1 / RATE)
    assert finder.scale == pytest.approx(scale, rel=0.005)


def test_a_tracker_finds_it_and_forgets_it_for_the_next_user(skeleton: Skeleton, stage: Stage) -> None:
    tracker = Tracker(skeleton, Calibration(automatic=True))
    height = POSTURE * 0.9 * stage.body.eye_height
    for t in seconds(5.0, 1 / RATE):
        tracker.update(stage.sample(t, head=(0.0, height, 0.1)))
    found = tracker.calibration
    assert found.scale == pytest.approx(0.9, abs=0.02) and found.automatic
    assert found.eye_height == pytest.approx(height, abs=0.02)
    tracker.reset()
    assert tracker.calibration == Calibration(automatic=True)
    tracker.update(stage.sample(0.0, head=(0.0, height, 0.1)))
    assert tracker.calibration.scale == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("solver", [pytest.param("learned", marks=pytest.mark.extra(name="learned")), "analytic"])
def test_who_is_taller_does_not_begin_on_tiptoe(skeleton: Skeleton, stage: Stage, solver: SolverName) -> None:
    tracker = Tracker(skeleton, Calibration(automatic=True), solver=solver)
    height = 1.04 * stage.body.eye_height  # that the avatar reaches on its toes alone
    ankles = [skeleton.names.index(f"{side}_ankle") for side in ("left", "right")]
    for t in seconds(2.0, 1 / RATE):
        bones = tracker.update(stage.sample(t, head=(0.0, height, 0.1))).bones(skeleton)[ankles]
        places = np.einsum("nij,nj->ni", bones[:, :3, :3], skeleton.joints[ankles]) + bones[:, :3, 3]
        assert (places[:, 1] < skeleton.joints[ankles, 1] + 0.025).all()


def test_who_once_looked_too_tall_is_not_kept_so(body: Body) -> None:
    finder = BodySizeFinder(body, 1.0)
    scale = finder.update((0.0, 1.3 * body.eye_height, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)  # a headset held up
    assert scale > 1.3
    for _ in range(6 * RATE):
        scale = finder.update((0.0, POSTURE * body.eye_height, 0.0), (1.0, 0.0, 0.0, 0.0), [], 1 / RATE)
    assert scale == pytest.approx(1.0, abs=0.02)


def test_an_explicit_calibration_wins_and_its_file_keeps_what_is_found(
    skeleton: Skeleton, stage: Stage, tmp_path: Path
) -> None:
    still = [stage.sample(t, head=(0.0, 1.4, 0.1)) for t in seconds(6.0, 1 / RATE)]
    known = calibrate(still, skeleton)
    assert known.found == pytest.approx(known.scale / POSTURE, rel=0.02)
    known.save(tmp_path / "me.json")
    assert Calibration.load(tmp_path / "me.json") == known
    tracker = Tracker(skeleton, known)
    for sample in still:
        tracker.update(sample)
    assert tracker.calibration == known


def test_a_size_is_found_in_a_recording_of_who_does_not_stand_still(skeleton: Skeleton, stage: Stage) -> None:
    eyes = POSTURE * 0.85 * stage.body.eye_height
    places = [(t, (0.8 * t, eyes + 0.02 * np.sin(12 * t), 0.1)) for t in seconds(4.0, 1 / RATE)]
    walks = [stage.sample(t, head=head, left=None, right=None) for t, head in places]
    with pytest.raises(PoseError, match="the head moved"):
        calibrate(walks, skeleton)
    assert found_size(walks, skeleton).scale == pytest.approx(0.85, rel=0.03)
    nobody = found_size([Sample(t, None) for t in seconds(1.0)], skeleton)
    assert nobody.scale == 1.0 and nobody.eye_height is None


@pytest.mark.extra(name="learned")
@pytest.mark.parametrize("size", [1.0, 0.9])
def test_a_hand_raised_beside_a_still_head_moves_no_foot(
    skeleton: Skeleton, stage: Stage, track: Track, size: float
) -> None:
    """Whoever has the avatar's size, and whoever is smaller and never calibrated."""
    samples = []
    eye = (0.0, POSTURE * size * stage.body.eye_height, 0.1)
    for t in seconds(8.0, 1 / RATE):
        up = 0.5 - 0.5 * np.cos(np.pi * np.clip(t - 5, 0, 2))
        left = tuple(size * v for v in (0.25 + 0.3 * up, 1.07 + 0.8 * up, 0.15 + 0.1 * up))
        samples.append(stage.sample(t, head=eye, left=left, right=tuple(size * v for v in (-0.25, 1.07, 0.15))))
    run = track(samples, solver="learned", calibration=Calibration(automatic=True))
    known = 1 if size == 1 else 4  # seconds until the size is
    feet = run.joints[known * RATE :, list(FEET)]
    assert np.ptp(feet, axis=0).max() < 0.01
