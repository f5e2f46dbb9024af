from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Calibration, Sample, Tracker, calibrate
from glsplat.tracking.solve.body import WRISTS, Body
from tests.tracking.moves import Stage, head_turn, seconds


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
    broken = ["[]", "[1]", "{", "{}", '{"floor": 0}']
    for text in (*broken, *(f'{{"scale": {value}}}' for value in ('"tall"', '"1"', "9", "true", "null"))):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"me\.json"):
            Calibration.load(path)
    with pytest.raises(FormatError, match="missing"):
        Calibration.load(tmp_path / "missing.json")


def test_other_rigs_are_refused(skeleton: Skeleton) -> None:
    with pytest.raises(PoseError, match="no joint for head, left_hip"):
        Body.of(Skeleton.from_joints(("a", "b"), [-1, 0], [[0, 0, 0], [0, 1, 0]]))
    twisted = skeleton.rest.copy()
    twisted[3, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    with pytest.raises(PoseError, match="parallel"):
        Body.of(Skeleton(skeleton.names, skeleton.parents, twisted))
