"""The tracker's promises on input that nobody should send."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from glsplat.data import default_avatar
from glsplat.errors import PoseError
from glsplat.rotations import rotation_matrices
from glsplat.tracking.sample import Sample
from glsplat.tracking.tracker import Tracker


def sample(t: float, head: list[float] | None, left: list[float] | None = None) -> Sample:
    return Sample.from_json({"t": t, "head": head, "left": left, "right": None})


def test_a_gap_that_ends_with_the_head_lost() -> None:
    tracker = Tracker(default_avatar().skeleton)
    tracker.update(sample(0.0, [0, 1.7, 0, 0, 0, 0, 1]))
    pose = tracker.update(sample(10.0, None, [0.3, 1.0, -0.3, 0, 0, 0, 1]))
    assert np.isfinite(pose.rotations).all() and {"head_lost", "gap"} <= set(tracker.flags)


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
    ],
    ids=str,
)
def test_a_sample_of_anything_gives_a_pose_and_a_flag(bad: dict[str, Any], flag: str) -> None:
    tracker = Tracker(default_avatar().skeleton)
    for t in (0.0, 0.01, 0.02):
        pose = tracker.update(Sample(**{"t": t, "head": STANDING, "left": STANDING, "right": STANDING, **bad}))
        assert np.isfinite(pose.rotations).all() and flag in tracker.flags
    assert "invalid" in tracker.flags or "t" in bad


def test_numpy_numbers_are_numbers() -> None:
    one, two = (Tracker(default_avatar().skeleton) for _ in range(2))
    for t in (0.0, 0.01):
        plain = one.update(Sample(t, STANDING, STANDING))
        array = two.update(Sample(np.float64(t), np.array(STANDING), np.array(STANDING)))  # type: ignore[arg-type]
        np.testing.assert_array_equal(plain.rotations, array.rotations)


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
    for nonsense in ("jawOpen", [0.5], {"jawOpen": "wide"}, {"jawOpen": None}, {"": 1.0}, {3: 1.0}, many):
        assert tracker.update(Sample(tracker._time + 0.1, head, expression=nonsense)).expression == {}  # type: ignore[arg-type, operator]
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
