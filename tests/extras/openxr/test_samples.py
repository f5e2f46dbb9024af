"""What runtimes track, as samples: hands, grips, body, faces, gaze, and gestures."""

from __future__ import annotations

import json
from dataclasses import replace
from math import cos, nan, sin

import numpy as np
import pytest

from glsplat.extras.openxr.runtime import Devices, FrameTiming
from glsplat.extras.openxr.wearer import (
    BODY_INDEX,
    HTC_EYES,
    HTC_LIPS,
    META,
    Wearer,
    expression_of_htc,
    expression_of_meta,
    pinched,
    sample_of,
)
from glsplat.skinning.expression import ARKIT
from glsplat.tracking.sample import BODY_JOINTS, Sample, wrist_from_grip
from tests.extras.openxr.fake import GRIPS, HEAD, PERIOD, FakeRuntime


def hand(rng: np.random.Generator) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in rng.normal(size=(26, 7)).tolist())


def test_a_hand_loses_its_palm_and_wins_over_its_controller(rng: np.random.Generator) -> None:
    left = hand(rng)
    sample = sample_of(Devices(head=HEAD, hands=(left, None), grips=GRIPS, triggers=(1.0, 1.0)), 2.5)  # type: ignore[arg-type]
    assert sample.t == 2.5 and sample.head == HEAD
    assert sample.left == left[1] and sample.left_curl is None
    assert sample.left_joints == tuple(joint[:3] for joint in left[1:]) and len(sample.left_joints) == 25
    assert sample.right == wrist_from_grip(GRIPS[1], "right") and sample.right_joints is None
    assert sample.right_curl == pytest.approx(0.25 + 0.75 * 0.5)  # one finger is not a fist
    again = Sample.from_json(json.loads(json.dumps(sample.to_json())))
    assert again == sample


def test_what_is_not_tracked_is_not_there() -> None:
    sample = sample_of(Devices(), 0.0)
    assert sample == Sample(0.0)
    closed = sample_of(Devices(head=HEAD, grips=GRIPS, squeezes=(1.0, 0.0)), 0.0)
    assert closed.left_curl == 1 and closed.right_curl == 0.25


def test_a_body_by_its_joints() -> None:
    """Numbers of XrBodyJointFB and XrFullBodyJointMETA in the registry's openxr.h."""
    assert BODY_INDEX == {
        **{"hips": 1, "spine-lower": 2, "left-upper-leg": 70, "left-lower-leg": 71, "left-foot-ankle": 73},
        **{"left-foot-ball": 76, "right-upper-leg": 77, "right-lower-leg": 78, "right-foot-ankle": 80},
        "right-foot-ball": 83,
    }
    joints = [(float(i), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) for i in range(84)]
    full = sample_of(Devices(head=HEAD, body=[*joints[:80], None, *joints[81:]]), 0.0)
    assert full.body == {name: (float(i), 0.0, 0.0) for name, i in BODY_INDEX.items() if i != 80}
    upper = sample_of(Devices(head=HEAD, body=joints[:70]), 0.0)
    assert set(upper.body or ()) == {"hips", "spine-lower"} < set(BODY_JOINTS)
    assert sample_of(Devices(head=HEAD, body=[None] * 70), 0.0).body is None


def test_metas_face_has_every_shape_once() -> None:
    assert set(META) == set(ARKIT)
    used = [i for indices in META.values() for i in indices]
    assert len(used) == len(set(used)) and max(used) == 68
    # what no shape of ARKit is: cheeks sucked in, lips tightened, the tongue within the mouth
    assert set(range(70)) - set(used) == {6, 7, 48, 49, 63, 64, 65, 66, 67, 69}


def test_metas_numbers() -> None:
    for index, name in {
        12: "eyeBlinkLeft", 13: "eyeBlinkRight", 24: "jawOpen", 33: "mouthSmileRight", 57: "browOuterUpLeft",
        16: "eyeLookOutLeft", 17: "eyeLookInRight", 26: "jawRight", 61: "mouthUpperUpLeft",
    }.items():  # fmt: skip
        weights = [0.0] * 70
        weights[index] = 0.625
        assert expression_of_meta(weights) == {name: 0.625}
    weights = [0.0] * 70
    weights[34:38] = [0.2, 0.4, 0.6, 0.8]
    weights[24] = nan
    found = expression_of_meta(weights)
    assert found["mouthFunnel"] == pytest.approx(0.5) and found["jawOpen"] != found["jawOpen"]
    assert expression_of_meta(weights[:10]) == {}  # as many as came
    assert sample_of(Devices(head=HEAD, face=weights), 0.0).expression == pytest.approx(found, nan_ok=True)


def test_htcs_face() -> None:
    assert set(HTC_EYES) | set(HTC_LIPS) <= set(ARKIT) and not set(HTC_EYES) & set(HTC_LIPS)
    eyes, lips = [0.0] * 14, [0.0] * 37
    eyes[9], lips[15], lips[4] = 0.5, 0.75, 0.25
    wanted = {"eyeLookInRight": 0.5, "mouthFrownLeft": 0.75, "mouthClose": 0.25, "jawOpen": 0.25}
    assert expression_of_htc(eyes, lips) == wanted
    assert expression_of_htc(eyes, None) == {"eyeLookInRight": 0.5} and expression_of_htc(None, None) == {}
    assert sample_of(Devices(head=HEAD, lips_htc=lips), 0.0).expression == {k: wanted[k] for k in list(wanted)[1:]}


def test_gaze_is_told_in_the_heads_axes() -> None:
    head = (0.0, 1.6, 0.0, 0.0, sin(0.25), 0.0, cos(0.25))  # half a radian to the left
    same = sample_of(Devices(head=head, gaze=(0.0, 1.6, 0.0, *head[3:])), 0.0)
    assert same.left_eye == pytest.approx((0, 0, -1)) and same.right_eye == same.left_eye
    ahead = sample_of(Devices(head=head, gaze=HEAD), 0.0)
    assert ahead.left_eye == pytest.approx((sin(0.5), 0, -cos(0.5)))
    assert sample_of(Devices(gaze=HEAD), 0.0).left_eye is None


def pinch(distance: float) -> tuple[tuple[float, ...], ...]:
    joints = [[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0] for _ in range(26)]
    joints[10][0] = distance
    return tuple(tuple(joint) for joint in joints)


def test_fingers_part_later_than_they_meet() -> None:
    found = [pinched(pinch(x), before) for x, before in ((0.01, False), (0.02, False), (0.02, True), (0.04, True))]
    assert found == [True, False, True, False] and not pinched(None, True)


class Worn:
    """A wearer whose frames are a period apart."""

    def __init__(self, wearer: Wearer) -> None:
        self.runtime, self.wearer, self.time = FakeRuntime(), wearer, 0
        self.runtime._running = True

    def look(self, seconds: float = 0.1, **tracked: object):
        self.time += int(seconds * 1e9)
        self.runtime.tracked = replace(self.runtime.tracked, **tracked)  # type: ignore[arg-type]
        return self.wearer.look(self.runtime, FrameTiming(self.time, PERIOD, True), True)


def test_a_button_goes_through_the_views_once_a_press() -> None:
    worn = Worn(Wearer("mirror"))
    seen = [worn.look(next_view=down).place.view for down in (False, True, True, False, True, False, True)]
    assert seen == ["mirror", "facing", "facing", "facing", "own", "own", "mirror"]


def test_two_pinches_of_the_left_hand_go_to_the_next_view() -> None:
    worn = Worn(Wearer("mirror"))
    meet, part = pinch(0.005), pinch(0.05)

    def views(*hands: object, seconds: float = 0.1) -> list[str]:
        return [worn.look(seconds, hands=(left, None)).place.view for left in hands]

    assert views(part, meet, part, meet, part) == ["mirror", "mirror", "mirror", "facing", "facing"]
    assert views(meet, part, meet, part, seconds=0.4) == ["facing"] * 4  # too slow
    worn.look(hands=(None, meet))
    worn.look(hands=(None, part))
    assert worn.look(hands=(None, meet)).place.view == "facing"  # the right hand is for nothing
    for hand in (part, meet) * 2:  # nor are pinches before the runtime's own menu
        worn.time += 10**8
        worn.runtime.tracked = replace(worn.runtime.tracked, hands=(hand, None))
        moment = worn.wearer.look(worn.runtime, FrameTiming(worn.time, PERIOD, True), False)
    assert moment is not None and moment.place.view == "facing"


def test_views_stand_still_until_they_are_placed_anew() -> None:
    worn = Worn(Wearer("mirror"))
    first = worn.look().place
    moved = (1.0, 1.7, 0.0, 0.0, 0.7, 0.0, 0.7)
    assert worn.look(head=moved).place is first
    worn.wearer.recentred()
    again = worn.look().place
    assert again is not first and not np.allclose(again.shown, first.shown)
    assert worn.look(5.0).place is not again  # the headset was off
    last = worn.look().place
    assert worn.look(head=None).place is last  # lost for a moment: all stays


def test_nothing_is_placed_before_there_was_a_head() -> None:
    heard: list[Sample] = []
    worn = Worn(Wearer("own", heard=heard.append))
    assert worn.look(head=None) is None and worn.look(head=HEAD) is not None
    assert len(heard) == 2 and heard[0].head is None and heard[1].head == HEAD


def test_with_others_a_user_begins_at_the_origin_looking_along_z_and_so_after_each_reset() -> None:
    worn = Worn(Wearer("facing", room=True))
    for angle in (0.9, 0.0, 0.7, -2.0):
        worn.wearer.recentred()
        moment = worn.look(head=(1.0, 1.6, angle, 0.0, sin(angle / 2), 0.0, cos(angle / 2)))
        assert moment.place.view == "own" and moment.place.whole
        x, y, z, w = moment.sample.head[3:]
        assert (2 * (x * z + w * y), 1 - 2 * (x * x + y * y)) == pytest.approx((0, -1), abs=1e-6), angle
        assert moment.sample.head[:3] == pytest.approx((0, 1.6, 0), abs=1e-6)
