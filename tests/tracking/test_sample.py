"""Samples: the wire form, recordings, and anything at all instead of one."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apps.tracking.options import read_poses
from glsplat.camera import head_matrix
from glsplat.data import default_avatar
from glsplat.errors import FormatError, PoseError
from glsplat.rotations import rotation_matrices
from glsplat.skinning.skeleton import Skeleton
from glsplat.tracking import Tracker, record, replay
from glsplat.tracking.recording import embedded_recording, write_lines
from glsplat.tracking.sample import Sample, wrist_from_grip
from tests.tracking.moves import Stage, seconds

HEAD = [0.1, 1.6, 0.2, 0.0, 0.0, 0.0, 1.0]


def test_wire_round_trip() -> None:
    wire = {"t": 2.5, "head": HEAD, "left": None, "right": HEAD, "right_joints": [[i, 0.0, 1.0] for i in range(25)]}
    sample = Sample.from_json(wire)
    assert sample.t == 2.5 and sample.left is None and sample.right == tuple(HEAD)
    assert sample.right_joints is not None and sample.right_joints[24] == (24.0, 0.0, 1.0)
    assert Sample.from_json(json.loads(json.dumps(sample.to_json()))) == sample


def test_joint_lists_may_be_flat_and_may_carry_the_palm() -> None:
    flat = Sample.from_json({"head": HEAD, "left_joints": [float(i) for i in range(175)]})
    assert flat.left_joints is not None and flat.left_joints[1] == tuple(float(i) for i in range(7, 14))
    palm = Sample.from_json({"head": HEAD, "left_joints": [[i, 0, 0] for i in range(26)]})
    assert palm.left_joints is not None and palm.left_joints[0] == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "wire",
    [
        [],
        {},
        {"head": [0, 1, 2]},
        {"head": "abcdefg"},
        {"head": [0, 1, 2, 0, 0, 0, "x"]},
        {"head": HEAD, "t": "now"},
        {"head": HEAD, "expression": [0.5] * 51},
        {"head": HEAD, "leftEye": [0.0, 1.0]},
        {"head": HEAD, "rightEye": "ahead"},
        {"head": HEAD, "expression": "jawOpen"},
        {"head": HEAD, "expression": {"jawOpen": "wide"}},
        {"head": HEAD, "expression": {"jawOpen": True}},
        {"head": HEAD, "expression": {str(i): 1.0 for i in range(257)}},
        {"head": HEAD, "left_joints": [[0, 0, 0]] * 24},
        {"head": HEAD, "left_joints": [1.0] * 70},
        {"head": HEAD, "left_joints": 3},
        {"head": [10**400, 0, 0, 0, 0, 0, 1]},
        {"head": [[0], 0, 0, 0, 0, 0, 1]},
    ],
)
def test_malformed_samples_are_refused(wire: object) -> None:
    with pytest.raises(PoseError):
        Sample.from_json(wire)


def test_an_expression_is_named_or_in_arkit_s_order() -> None:
    numbers = [0.0] * 52
    numbers[17] = 0.5
    for wire in ({"jawOpen": 0.5, "cheekPuff": 0.0, "tongueOut": None}, numbers):
        sample = Sample.from_json({"head": HEAD, "expression": wire})
        assert sample.expression == {"jawOpen": 0.5}
        assert Sample.from_json(json.loads(json.dumps(sample.to_json()))) == sample
    looking = Sample.from_json({"head": HEAD, "leftEye": [0.0, 0.1, -1.0], "rightEye": None})
    assert looking.left_eye == (0.0, 0.1, -1.0) and looking.right_eye is None
    assert Sample.from_json(json.loads(json.dumps(looking.to_json()))) == looking
    assert "expression" not in Sample.from_json({"head": HEAD}).to_json()


def test_nan_is_left_to_the_tracker() -> None:
    sample = Sample.from_json({"head": [math.nan] * 7})
    assert sample.head is not None and math.isnan(sample.head[0])


@pytest.mark.parametrize(("side", "back", "thumb"), [("left", (-1, 0, 0), (1, 0, 0)), ("right", (1, 0, 0), (-1, 0, 0))])
def test_a_grip_becomes_the_wrist_of_that_hand(side: str, back: tuple[int, ...], thumb: tuple[int, ...]) -> None:
    # an arm that hangs with the thumb forward holds a straight grip at identity: fingers down, palms inwards
    wrist = wrist_from_grip((0.3, 0.8, 0.0, 0.0, 0.0, 0.0, 1.0), side)
    frame = head_matrix(wrist[:3], wrist[3:])
    np.testing.assert_allclose(frame[:3, 2], (0, 1, 0), atol=1e-12)  # +z: from the fingers back to the forearm
    np.testing.assert_allclose(frame[:3, 1], back, atol=1e-12)  # +y: out of the back of the hand
    np.testing.assert_allclose(frame[:3, 0] * thumb[0], (0, 0, -1), atol=1e-12)  # the thumb's side is forward (-z)
    np.testing.assert_allclose(frame[:3, 3], (0.3, 0.89, 0.0), atol=1e-12)
    sample = Sample.from_json({"head": HEAD, f"{side}_grip": [0.3, 0.8, 0, 0, 0, 0, 1]})
    assert getattr(sample, side) == pytest.approx(wrist)


STANDING = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("bad", "flag"),
    [
        ({"t": None}, "time_invalid"),
        ({"t": "1"}, "time_invalid"),
        ({"t": 10**400}, "time_invalid"),
        ({"head": "abcdefg"}, "head_lost"),
        ({"head": 5}, "head_lost"),
        ({"head": (1, 2)}, "head_lost"),
        ({"head": tuple("0101001")}, "head_lost"),
        ({"left": [None] * 7}, "left_lost"),
        ({"left": {}}, "left_lost"),
        ({"left": np.zeros((7, 3))}, "left_lost"),
        ({"left_joints": 5}, "invalid"),
        ({"left_joints": "x" * 25}, "invalid"),
        ({"left_joints": ((0.0,),) * 25}, "invalid"),
        ({"right_curl": "fist"}, "invalid"),
        ({"right_curl": [1]}, "invalid"),
        ({"body": 5}, "invalid"),
        ({"body": {"hips": (1.0,)}}, "invalid"),
        ({"waist": "waist"}, "invalid"),
    ],
    ids=str,
)
def test_a_sample_of_anything_gives_a_pose_and_a_flag(bad: dict[str, Any], flag: str) -> None:
    tracker = Tracker(default_avatar().skeleton)
    for t in (0.0, 0.01, 0.02):
        pose = tracker.update(Sample(**{"t": t, "head": STANDING, "left": STANDING, "right": STANDING, **bad}))
        assert np.isfinite(pose.rotations).all() and flag in tracker.flags
    assert tracker.flags.count("invalid") == 1 or "t" in bad


def test_what_is_not_a_sample_is_refused_in_one_line() -> None:
    with pytest.raises(PoseError, match="takes a Sample"):
        Tracker(default_avatar().skeleton).update({"head": STANDING})  # type: ignore[arg-type]


def test_the_pose_of_a_repeated_time_cannot_be_spoilt() -> None:
    tracker = Tracker(default_avatar().skeleton)
    first = tracker.update(Sample(0.0, STANDING))
    with pytest.raises(ValueError, match="read-only"):
        first.rotations[3] = 7.0
    with pytest.raises(ValueError, match="read-only"):
        first.trans += 1.0
    again = tracker.update(Sample(0.0, STANDING))
    np.testing.assert_array_equal(again.rotations, first.rotations)


@pytest.mark.parametrize("value", ["1.5", True, None, [1], {}])
@pytest.mark.parametrize("key", ["head", "left", "right_grip"])
def test_strings_and_bools_in_a_recording_are_not_numbers(key: str, value: Any) -> None:
    with pytest.raises(PoseError, match=f'"{key}" of a tracking sample needs numbers'):
        Sample.from_json({"t": 0, "head": list(STANDING), key: [0, value, 0, 0, 0, 0, 1]})
    assert math.isnan(Sample.from_json({"head": [math.nan, *STANDING[1:]]}).head[0])  # type: ignore[index]


def test_the_face_of_a_sample_is_that_of_the_pose() -> None:
    tracker = Tracker(default_avatar().skeleton)
    head = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert tracker.update(Sample(0.0, head)).expression == {}
    assert tracker.update(Sample(0.1, head, expression={"jawOpen": 0.5})).expression == {"jawOpen": 0.5}
    assert "invalid" not in tracker.flags
    bad = {"jawOpen": float("nan"), "cheekPuff": 0.25, "tongueOut": float("inf")}
    assert tracker.update(Sample(0.2, head, expression=bad)).expression == {"cheekPuff": 0.25}
    assert "invalid" in tracker.flags
    many = {str(i): 1.0 for i in range(300)}
    all_nonsense: list[Any] = ["jawOpen", [0.5], {"jawOpen": "wide"}, {"jawOpen": None}, {"": 1.0}, {3: 1.0}, many]
    for i, nonsense in enumerate(all_nonsense):
        assert tracker.update(Sample(0.3 + 0.1 * i, head, expression=nonsense)).expression == {}
        assert "invalid" in tracker.flags


@pytest.mark.parametrize(
    "gaze, at",
    [
        ((0, 0, -1), (0, 0, 1)),  # ahead
        ((0.3, 0, -1), (-0.3, 0, 1)),  # to the user's right, which is the body's -x
        ((0, 0.4, -1), (0, 0.4, 1)),  # up
        ((-0.2, -0.3, -2), (0.2, -0.3, 2)),
    ],
)
def test_eyes_turn_to_where_they_look(gaze: tuple[float, ...], at: tuple[float, ...]) -> None:
    tracker = Tracker(default_avatar().skeleton)
    head = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0)
    pose = tracker.update(Sample(0.0, head, left_eye=gaze))
    looks = rotation_matrices(pose.rotations[23]) @ (0, 0, 1)
    assert looks == pytest.approx(np.array(at) / np.linalg.norm(at), abs=1e-9)
    assert not pose.rotations[24].any()
    axis = pose.rotations[23]
    assert axis[2] == pytest.approx(0, abs=1e-9)  # no roll


def test_eyes_stay_in_their_sockets_and_at_rest_without_a_direction() -> None:
    tracker = Tracker(default_avatar().skeleton)
    head = (0.0, 1.6, 0.0, 0.0, 0.0, 0.0, 1.0)
    for count, gaze in enumerate(((1, 0, 0), (0, 0, 1), (0, -5, 1e-9))):
        turn = tracker.update(Sample(0.1 * count, head, right_eye=gaze)).rotations[24]
        assert np.linalg.norm(turn) == pytest.approx(0.75)
    for count, gaze in enumerate(((0, 0, 0), (float("nan"), 0, -1), (float("inf"), 0, 0), None), 5):
        assert not tracker.update(Sample(0.1 * count, head, right_eye=gaze)).rotations[24].any()
        assert "invalid" not in tracker.flags
    for count, bad in enumerate(("ahead", (1, 2), ("a", "b", "c"), 7), 10):
        pose = tracker.update(Sample(0.1 * count, head, right_eye=bad))  # type: ignore[arg-type]
        assert not pose.rotations[24].any() and "invalid" in tracker.flags


def test_record_and_replay(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "rec.jsonl"
    samples = [stage.sample(t, left=None, right_curl=0.5) for t in seconds(0.1)]
    assert record(path, samples) == len(samples)
    again = list(replay(path))
    assert [s.t for s in again] == pytest.approx([s.t for s in samples], abs=1e-6)
    np.testing.assert_allclose([s.head for s in again], [s.head for s in samples], atol=1e-6)
    assert again[0].left is None and again[0].right_curl == 0.5
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rec.jsonl"]


def test_a_failed_recording_leaves_the_old_file(stage: Stage, tmp_path: Path) -> None:
    path = tmp_path / "rec.jsonl"
    path.write_text("old")

    def broken():
        yield stage.sample(0.0)
        raise RuntimeError("unplugged")

    with pytest.raises(RuntimeError):
        record(path, broken())
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    "text", ["{", "[1, 2]", '{"t": 0}', '{"head": [1, 2]}', '{"head": "here"}', "null", "\x00\x01", "[" * 100_000]
)
def test_bad_lines_name_file_and_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rec.jsonl"
    path.write_text('{"t": 0, "head": [0, 1, 0, 0, 0, 0, 1]}\n\n' + text + "\n")
    with pytest.raises(FormatError, match=r"rec\.jsonl, line 3"):
        list(replay(path))
    with pytest.raises(FormatError, match=r"rec\.jsonl, line 1"):
        read_poses(path)


def test_missing_and_empty_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="none"):
        list(replay(tmp_path / "none.jsonl"))
    (tmp_path / "empty.jsonl").write_text("\n")
    assert list(replay(tmp_path / "empty.jsonl")) == []
    with pytest.raises(FormatError, match="found none"):
        read_poses(tmp_path / "empty.jsonl")


def test_numbers_are_rounded_and_nan_is_null(tmp_path: Path) -> None:
    path = tmp_path / "x.jsonl"
    write_lines(path, [{"a": 1 / 3, "b": [math.nan, math.inf], "c": "text", "d": None, "e": 3}])
    assert json.loads(path.read_text()) == {"a": 0.333333, "b": [None, None], "c": "text", "d": None, "e": 3}


def test_the_embedded_recording_is_ordinary(skeleton: Skeleton) -> None:
    samples = embedded_recording()
    steps = np.diff([s.t for s in samples])
    assert len(samples) > 300 and steps == pytest.approx(np.full(len(steps), 1 / 72), abs=2e-6)
    tracker = Tracker(skeleton)
    for sample in samples:
        pose = tracker.update(sample)
        assert np.isfinite(pose.rotations).all()
        assert not {"teleport", "gap", "head_lost", "head_limit", "airborne"} & set(tracker.flags)


def sample_of(t: float, head: list[float] | None, left: list[float] | None = None) -> Sample:
    return Sample.from_json({"t": t, "head": head, "left": left, "right": None})


def test_a_gap_that_ends_with_the_head_lost() -> None:
    tracker = Tracker(default_avatar().skeleton)
    tracker.update(sample_of(0.0, [0, 1.7, 0, 0, 0, 0, 1]))
    pose = tracker.update(sample_of(10.0, None, [0.3, 1.0, -0.3, 0, 0, 0, 1]))
    assert np.isfinite(pose.rotations).all() and {"head_lost", "gap"} <= set(tracker.flags)


def test_numpy_numbers_are_numbers() -> None:
    one, two = (Tracker(default_avatar().skeleton) for _ in range(2))
    for t in (0.0, 0.01):
        plain = one.update(Sample(t, STANDING, STANDING))
        array = two.update(Sample(np.float64(t), np.array(STANDING), np.array(STANDING)))  # type: ignore[arg-type]
        np.testing.assert_array_equal(plain.rotations, array.rotations)
