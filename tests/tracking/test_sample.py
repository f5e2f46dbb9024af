from __future__ import annotations

import json
import math

import numpy as np
import pytest

from glsplat.camera import head_matrix
from glsplat.errors import PoseError
from glsplat.tracking.sample import HAND_JOINTS, Sample, wrist_from_grip

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
    assert len(HAND_JOINTS) == 25 and HAND_JOINTS[5] == "index-finger-metacarpal"


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
