"""Wearer: the state of a session's user: tracked devices as the tracker's Sample, view, gestures and standing place.

Devices are converted as the page does for WebXR (track/xr-sample.js). Faces of OpenXR's extensions become ARKit's 52
shapes: XR_FB_face_tracking2 (XrFaceExpression2FB: 70 weights after FACS; Meta's documentation "Movement SDK: ARKit
mapping" has the table) and XR_HTC_facial_tracking (XrEyeExpressionHTC: 14, XrLipExpressionHTC: 37).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import dist
from typing import Any

from glsplat.extras.openxr.openxr.runtime import OpenXrRuntime
from glsplat.extras.openxr.placing import VIEWS, Place, ViewName, matrix_of, placing, standing
from glsplat.extras.openxr.runtime import Devices, FrameTiming
from glsplat.skinning.expression import ARKIT
from glsplat.tracking.sample import BODY_JOINTS, Sample, Transform, wrist_from_grip
from glsplat.tracking.solve.quat import conj, mul, rotate

Table = Mapping[str, tuple[int, ...]]  # ARKit's shape -> the weights of which it is the mean

HTC_LIPS: Table = {
    **{"jawRight": (0,), "jawLeft": (1,), "jawForward": (2,), "jawOpen": (3,), "mouthClose": (4,)},
    **{"mouthRight": (5, 7), "mouthLeft": (6, 8), "mouthFunnel": (9, 10), "mouthPucker": (11,)},
    **{"mouthSmileRight": (12,), "mouthSmileLeft": (13,), "mouthFrownRight": (14,), "mouthFrownLeft": (15,)},
    **{"cheekPuff": (16, 17), "mouthUpperUpRight": (19,), "mouthUpperUpLeft": (20,)},
    **{"mouthLowerDownRight": (21,), "mouthLowerDownLeft": (22,), "mouthRollUpper": (23,), "mouthRollLower": (24,)},
    **{"mouthShrugLower": (25,), "tongueOut": (26, 32)},
}
_APE = 4  # XR_LIP_EXPRESSION_MOUTH_APE_SHAPE_HTC: jaw open behind closed lips, ARKit's mouthClose and jawOpen

GRASP = 0.25  # curl of fingers around a controller that presses nothing

# XrBodyJointFB, and from 70 on XrFullBodyJointMETA (XR_META_body_tracking_full_body)
_INDICES = (1, 2, 70, 71, 73, 76, 77, 78, 80, 83)
BODY_INDEX: dict[str, int] = dict(zip(BODY_JOINTS, _INDICES, strict=True))
"""Index of each joint that is used."""

_WRIST, _THUMB_TIP, _INDEX_TIP = 1, 5, 10  # of XrHandJointEXT
_PINCHED, _OPEN = 0.015, 0.03  # distance of finger tips that starts and ends a pinch, metres

_DOUBLE = 0.5  # most seconds between two pinches of the left hand that select the next view
_IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_STALE = 2.0  # seconds without a frame (the headset was off) after which the view is placed again


def _pairs(**first: int) -> dict[str, tuple[int, ...]]:
    """Return entries for both sides; the right weight follows the left."""
    return {name + side: (index + i,) for name, index in first.items() for i, side in enumerate(("Left", "Right"))}


META: Table = {
    **_pairs(browDown=0, cheekSquint=4, mouthDimple=10, eyeBlink=12, eyeLookDown=14, eyeLookUp=20, eyeSquint=28),
    **_pairs(mouthFrown=30, mouthSmile=32, mouthPress=38, mouthStretch=42, mouthLowerDown=51, noseSneer=55),
    **_pairs(browOuterUp=57, eyeWide=59, mouthUpperUp=61),
    # weights are to the user's left and right, ARKit's in and out
    **{"eyeLookOutLeft": (16,), "eyeLookInRight": (17,), "eyeLookInLeft": (18,), "eyeLookOutRight": (19,)},
    **{"browInnerUp": (22, 23), "cheekPuff": (2, 3), "jawOpen": (24,), "jawLeft": (25,), "jawRight": (26,)},
    **{"jawForward": (27,), "mouthClose": (50,), "mouthFunnel": (34, 35, 36, 37), "mouthPucker": (40, 41)},
    **{"mouthRollLower": (44, 46), "mouthRollUpper": (45, 47), "mouthShrugLower": (8,), "mouthShrugUpper": (9,)},
    **{"mouthLeft": (53,), "mouthRight": (54,), "tongueOut": (68,)},
}

HTC_EYES: Table = {
    **{"eyeBlinkLeft": (0,), "eyeWideLeft": (1,), "eyeBlinkRight": (2,), "eyeWideRight": (3,)},
    **_pairs(eyeSquint=4, eyeLookDown=6, eyeLookUp=12),
    **{"eyeLookOutLeft": (8,), "eyeLookInRight": (9,), "eyeLookInLeft": (10,), "eyeLookOutRight": (11,)},
}


def expression_of_meta(weights: Sequence[float]) -> dict[str, float]:
    """Return ARKit's weights by name, without zeros, from the 70 of XrFaceExpression2FB."""
    return _mapped(META, weights)


def expression_of_htc(eyes: Sequence[float] | None, lips: Sequence[float] | None) -> dict[str, float]:
    """Return ARKit's weights from XrEyeExpressionHTC's 14 and XrLipExpressionHTC's 37; None: no such tracker."""
    out = {} if eyes is None else _mapped(HTC_EYES, eyes)
    if lips is not None:
        out |= _mapped(HTC_LIPS, lips)
        if len(lips) > _APE and lips[_APE] > out.get("jawOpen", 0.0):
            out["jawOpen"] = float(lips[_APE])
    return out


def _mapped(table: Table, weights: Sequence[float]) -> dict[str, float]:
    found = {}
    for name in ARKIT:
        indices = table.get(name)
        if indices and indices[-1] < len(weights):
            value = sum(weights[i] for i in indices) / len(indices)
            if value:  # NaN is kept for the tracker to refuse
                found[name] = float(value)
    return found


def sample_of(devices: Devices, t: float) -> Sample:
    """Return the sample at ``t`` seconds. A tracked hand has priority over a controller."""
    fields: dict[str, Any] = {}
    for index, side in enumerate(("left", "right")):
        joints, grip = devices.hands[index], devices.grips[index]
        if joints is not None:
            fields[side] = joints[_WRIST]
            fields[f"{side}_joints"] = tuple(joint[:3] for joint in joints[_WRIST:])
        elif grip is not None:
            fields[side] = wrist_from_grip(grip, side)
            pressed = max(devices.squeezes[index], devices.triggers[index] / 2)  # one finger is not a fist
            fields[f"{side}_curl"] = GRASP + (1 - GRASP) * pressed
    if devices.body is not None:
        found = {name: devices.body[i] for name, i in BODY_INDEX.items() if i < len(devices.body)}
        fields["body"] = {name: joint[:3] for name, joint in found.items() if joint is not None} or None
    if devices.face is not None:
        fields["expression"] = expression_of_meta(devices.face)
    elif devices.eyes_htc is not None or devices.lips_htc is not None:
        fields["expression"] = expression_of_htc(devices.eyes_htc, devices.lips_htc)
    if devices.gaze is not None and devices.head is not None:
        fields["left_eye"] = fields["right_eye"] = _ahead(devices.gaze, devices.head)
    return Sample(t, devices.head, **fields)


def pinched(joints: tuple[Transform, ...] | None, before: bool) -> bool:
    """Return whether a hand pinches; a pinch that held ``before`` ends at a larger distance."""
    if joints is None:
        return False
    return dist(joints[_THUMB_TIP][:3], joints[_INDEX_TIP][:3]) < (_OPEN if before else _PINCHED)


def _ahead(gaze: Transform, head: Transform) -> tuple[float, float, float]:
    """Return the gaze in the head's axes; eye_gaze_interaction has one direction for both eyes."""
    turn = mul(conj((head[6], *head[3:6])), (gaze[6], *gaze[3:6]))
    return rotate(turn, (0.0, 0.0, -1.0))


@dataclass(frozen=True, slots=True)
class Moment:
    """The user at one frame."""

    sample: Sample
    devices: Devices
    place: Place


class Wearer:
    """A session's user; call ``look`` once a frame. ``room``: a server's room with others (docs/protocol.md, 2.1)."""

    def __init__(
        self, view: ViewName = "mirror", room: bool = False, heard: Callable[[Sample], None] = lambda _: None
    ) -> None:
        self.view: ViewName = view
        self.room = room
        self._heard = heard  # receives every sample
        self._place: Place | None = None
        self._stood = not room
        self._moved = False  # whether the space was moved to the standing place
        self._pressed = self._pinching = False
        self._pinched = self._last = float("-inf")

    def look(self, runtime: OpenXrRuntime, timing: FrameTiming, focused: bool) -> Moment | None:
        """Return the user at the frame's display time; None until the head was tracked once."""
        now = timing.display_time * 1e-9
        devices = runtime.devices(timing.display_time, focused)
        if devices.head is not None and not self._stood:
            if self._moved:  # the standing place is in the runtime's own space
                runtime.move(_IDENTITY)
                devices = runtime.devices(timing.display_time, focused)
        if devices.head is not None and not self._stood:
            x, z, sine, cosine = standing(matrix_of(devices.head))
            runtime.move((x, 0.0, z, 0.0, sine, 0.0, cosine))
            self._stood = self._moved = True
            self._place = None
            devices = runtime.devices(timing.display_time, focused)
        if now - self._last > _STALE:
            self._place = None
        self._last = now
        if focused:  # pinches in the runtime's own menu do not count
            self._gestures(devices, now)
        if devices.head is not None and self._place is None:
            self._place = placing(self.view, matrix_of(devices.head), self.room)
        sample = sample_of(devices, now)
        self._heard(sample)
        return None if self._place is None else Moment(sample, devices, self._place)

    def next_view(self) -> None:
        """Show the next of mirror, facing and own body, placed in front of the user."""
        self.show(VIEWS[(VIEWS.index(self.view) + 1) % len(VIEWS)])

    def show(self, view: ViewName) -> None:
        """Show this view, placed in front of the user."""
        self.view, self._place = view, None

    def recentred(self) -> None:
        """Place the view in front of the user again: the origin of their space has changed."""
        self._place = None
        self._stood = not self.room

    def _gestures(self, devices: Devices, now: float) -> None:
        """Go to the next view at button A or X, or two pinches of the left hand."""
        if devices.next_view and not self._pressed:
            self.next_view()
        self._pressed = devices.next_view
        pinching = pinched(devices.hands[0], self._pinching)
        if pinching and not self._pinching:
            if now - self._pinched < _DOUBLE:
                self.next_view()
                self._pinched = float("-inf")
            else:
                self._pinched = now
        self._pinching = pinching
