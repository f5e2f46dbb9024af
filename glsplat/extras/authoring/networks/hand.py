"""Find a hand's 21 landmarks, from the body network's wrist and knuckles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64

from .network import Crop, network
from .person import DetectedBody

LANDMARKS = (
    "wrist thumb_cmc thumb_mcp thumb_ip thumb_tip index_mcp index_pip index_dip index_tip middle_mcp middle_pip "
    "middle_dip middle_tip ring_mcp ring_pip ring_dip ring_tip pinky_mcp pinky_pip pinky_dip pinky_tip"
).split()
"""Names of the 21 landmarks, in order."""

_INPUT_PX = 224  # side of the network's input
_CROP_ROUNDS = 2  # the second crop comes from the first landmarks
_CROP_LANDMARKS = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]  # without the outer finger joints, which move


@dataclass(frozen=True, eq=False)
class Hand:
    """The hand network's result for one hand."""

    points: F64
    """[21, 2] pixels of the picture (first pixel's centre at 0.5), in the order of LANDMARKS."""
    world: F64
    """[21, 3] metres from a point in the hand; x right, y down, z away from the camera."""
    presence: float
    """Probability that the crop shows a hand."""
    crop: Crop
    """The network's input."""


def find_hand(picture: NDArray[np.uint8], body: DetectedBody, side: str) -> Hand:
    """Return the body's ``left`` or ``right`` hand; a low ``presence`` means that it is not shown."""
    wrist = body.point(f"{side}_wrist")
    fingers = (body.point(f"{side}_index") + body.point(f"{side}_pinky")) / 2
    along = fingers - wrist
    reach = max(float(np.hypot(*along)), 1.0)
    middle = wrist + 1.2 * along
    crop = Crop(float(middle[0]), float(middle[1]), 3.6 * reach, _turn(along))
    net = network("hand_landmark_full", ("Identity", "Identity_1", "Identity_3"))
    for step in range(_CROP_ROUNDS):
        marks, presence, world = net(crop.cut(picture, _INPUT_PX))
        points = crop.to_picture(marks.reshape(21, 3)[:, :2].astype(np.float64), _INPUT_PX)
        if presence[0] < 0.2 or step == _CROP_ROUNDS - 1:
            break
        along = points[[5, 9, 13]].mean(axis=0) - points[0]
        crop = Crop.around(points[_CROP_LANDMARKS], _turn(along), 2.0, up=0.1)
    cos, sin = np.cos(crop.turn), np.sin(crop.turn)
    upright = world.reshape(21, 3).astype(np.float64)
    turned = np.column_stack([upright[:, :2] @ np.array([[cos, sin], [-sin, cos]]), upright[:, 2]])
    return Hand(points, turned, float(presence[0]), crop)


def _turn(along: F64) -> float:
    """Return the turn in radians of a crop in which the direction ``along`` [2] points up."""
    return float(np.arctan2(along[0], -along[1]))
