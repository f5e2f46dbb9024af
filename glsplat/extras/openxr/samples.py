"""Convert a runtime's devices to the tracker's Sample, as the page does for WebXR (track/xr-sample.js)."""

from __future__ import annotations

from math import dist
from typing import Any

from glsplat.extras.openxr.face import expression_of_htc, expression_of_meta
from glsplat.extras.openxr.runtime import Devices
from glsplat.tracking.sample import BODY_JOINTS, Sample, Transform, wrist_from_grip
from glsplat.tracking.solve.quat import conj, mul, rotate

GRASP = 0.25
"""Curl of fingers around a controller that presses nothing."""

# XrBodyJointFB, and from 70 on XrFullBodyJointMETA (XR_META_body_tracking_full_body)
_INDICES = (1, 2, 70, 71, 73, 76, 77, 78, 80, 83)
BODY_INDEX: dict[str, int] = dict(zip(BODY_JOINTS, _INDICES, strict=True))
"""Index of each joint that is used."""

_WRIST, _THUMB_TIP, _INDEX_TIP = 1, 5, 10  # of XrHandJointEXT
_PINCHED, _OPEN = 0.015, 0.03  # distance of finger tips that starts and ends a pinch, metres


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
