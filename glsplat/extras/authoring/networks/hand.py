"""A hand: 21 landmarks, found from where the body network saw the wrist and the knuckles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .network import Crop, network
from .person import DetectedBody

__all__ = ["LANDMARKS", "Hand", "find_hand", "hand_in"]

LANDMARKS = (
    "wrist thumb_cmc thumb_mcp thumb_ip thumb_tip index_mcp index_pip index_dip index_tip middle_mcp middle_pip "
    "middle_dip middle_tip ring_mcp ring_pip ring_dip ring_tip pinky_mcp pinky_pip pinky_dip pinky_tip"
).split()
"""Names of the 21 landmarks, in order."""

_SIDE = 224
_ROUNDS = 2  # the second crop comes from the first landmarks, which know the fingers
_KNUCKLES = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]  # the hand without its finger tips, which move


@dataclass(frozen=True, eq=False)
class Hand:
    """What the hand network says of one hand."""

    points: NDArray[np.float64]
    """[21, 2] pixels of the picture (first pixel's centre at 0.5), in the order of LANDMARKS."""
    world: NDArray[np.float64]
    """[21, 3] metres, turned as in the picture: x right, y down, z away; the origin lies in the hand."""
    presence: float
    """From 0 to 1: that the crop shows a hand."""
    crop: Crop
    """The square that the network saw."""


def find_hand(picture: NDArray[np.uint8], body: DetectedBody, side: str) -> Hand:
    """The body's ``left`` or ``right`` hand; ``presence`` says whether it is there."""
    wrist = body.point(f"{side}_wrist")
    fingers = (body.point(f"{side}_index") + body.point(f"{side}_pinky")) / 2
    along = fingers - wrist
    reach = max(float(np.hypot(*along)), 1.0)
    middle = wrist + 1.2 * along
    return hand_in(picture, Crop(float(middle[0]), float(middle[1]), 3.6 * reach, _turn(along)))


def hand_in(picture: NDArray[np.uint8], crop: Crop) -> Hand:
    """The hand that a rough crop shows, fingers up in it."""
    net = network("hand_landmark_full", ("Identity", "Identity_1", "Identity_3"))
    for step in range(_ROUNDS):
        marks, presence, world = net(crop.cut(picture, _SIDE))
        points = crop.to_picture(marks.reshape(21, 3)[:, :2].astype(np.float64), _SIDE)
        if presence[0] < 0.2 or step == _ROUNDS - 1:
            break
        crop = _around(points)
    cos, sin = np.cos(crop.turn), np.sin(crop.turn)
    upright = world.reshape(21, 3).astype(np.float64)
    turned = np.column_stack([upright[:, :2] @ np.array([[cos, sin], [-sin, cos]]), upright[:, 2]])
    return Hand(points, turned, float(presence[0]), crop)


def _around(points: NDArray[np.float64]) -> Crop:
    """The square that the network is meant to see of these landmarks."""
    along = points[[5, 9, 13]].mean(axis=0) - points[0]
    turn = _turn(along)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])  # rows: right and down in the crop
    inner = points[_KNUCKLES] @ axes.T
    low, high = inner.min(axis=0), inner.max(axis=0)
    side = float((high - low).max())
    middle = ((low + high) / 2 + (0, -0.1 * side)) @ axes
    return Crop(float(middle[0]), float(middle[1]), 2.0 * max(side, 1.0), turn)


def _turn(along: NDArray[np.float64]) -> float:
    """The turn of a crop in which ``along`` points up."""
    return float(np.arctan2(along[0], -along[1]))
