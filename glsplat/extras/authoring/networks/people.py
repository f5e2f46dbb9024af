"""Find one person's body, face and hands with all networks, and the side of the person that a picture shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64
from glsplat.extras.authoring.compute.threads import run_in_background
from glsplat.extras.authoring.networks.face import Face, face_probability, find_face
from glsplat.extras.authoring.networks.network import Crop, network
from glsplat.extras.authoring.networks.person import LANDMARKS, OPPOSITE, DetectedBody, find_body, people_mask

HAND_LANDMARKS = (
    "wrist thumb_cmc thumb_mcp thumb_ip thumb_tip index_mcp index_pip index_dip index_tip middle_mcp middle_pip "
    "middle_dip middle_tip ring_mcp ring_pip ring_dip ring_tip pinky_mcp pinky_pip pinky_dip pinky_tip"
).split()
"""Names of the 21 landmarks, in order."""
_INPUT_PX = 224  # side of the network's input
_CROP_ROUNDS = 2  # the second crop comes from the first landmarks
_CROP_LANDMARKS = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]  # without the outer finger joints, which move
Degrees = TypeVar("Degrees", float, F64)
SIDES: dict[str, float] = {"front": 0.0, "right": 90.0, "back": 180.0, "left": -90.0}
"""Side of the person that a picture shows -> degrees that they have turned to their own left to show it."""
_MIN_FACE_PROBABILITY = 0.5  # fronts have at least 0.8, backs at most 0.01
_HEAD_FROM_FACE = (  # points of the face mesh whose means replace the head's LANDMARKS, in their order
    *((1,), (362,), (362, 263), (263,), (133,), (133, 33), (33,)),  # nose; left and right eye from its inner corner
    *((454,), (234,), (291,), (61,)),  # ears, mouth's corners
)


@dataclass(frozen=True, eq=False)
class Hand:
    """The hand network's result for one hand."""

    points: F64
    """[21, 2] pixels of the picture (first pixel's centre at 0.5), in the order of HAND_LANDMARKS."""
    presence: float
    """Probability that the crop shows a hand."""


def find_hand(picture: NDArray[np.uint8], body: DetectedBody, side: str) -> Hand:
    """Return the body's ``left`` or ``right`` hand; a low ``presence`` means that it is not shown."""
    wrist = body.point(f"{side}_wrist")
    fingers = (body.point(f"{side}_index") + body.point(f"{side}_pinky")) / 2
    along = fingers - wrist
    reach = max(float(np.hypot(*along)), 1.0)
    middle = wrist + 1.2 * along
    crop = Crop(float(middle[0]), float(middle[1]), 3.6 * reach, _turn(along))
    net = network("hand_landmark_full", ("Identity", "Identity_1"))
    for step in range(_CROP_ROUNDS):
        marks, presence = net(crop.cut(picture, _INPUT_PX))
        points = crop.to_picture(marks.reshape(21, 3)[:, :2].astype(np.float64), _INPUT_PX)
        if presence[0] < 0.2 or step == _CROP_ROUNDS - 1:
            break
        along = points[[5, 9, 13]].mean(axis=0) - points[0]
        crop = Crop.around(points[_CROP_LANDMARKS], _turn(along), 2.0, up=0.1)
    return Hand(points, float(presence[0]))


def _turn(along: F64) -> float:
    """Return the turn in radians of a crop in which the direction ``along`` [2] points up."""
    return float(np.arctan2(along[0], -along[1]))


@dataclass(frozen=True, eq=False)
class DetectedPerson:
    """The networks' results for one person."""

    body: DetectedBody
    face: Face
    """Its ``presence`` is near 0 from behind."""
    left_hand: Hand
    right_hand: Hand
    head_parts: NDArray[np.uint8] | None = None
    """[H, W] from ``networks.head_parts``."""

    @property
    def turn(self) -> float:
        """Angle in radians between facing the camera and the shoulders: 0 from the front, about pi from behind."""
        across = self.body.world[LANDMARKS.index("left_shoulder")] - self.body.world[LANDMARKS.index("right_shoulder")]
        return float(np.arctan2(across[2], across[0]))


def find_person(picture: NDArray[np.uint8], people: F32 | None = None) -> DetectedPerson | None:
    """Return the largest person in an RGB picture, or None. ``people`` is ``people_mask(picture)`` if known."""
    body = find_body(picture, people_mask(picture) if people is None else people)
    if body is None:
        return None
    mirrored = body.point("left_shoulder")[0] < body.point("right_shoulder")[0]
    if mirrored and face_probability(picture, body) > _MIN_FACE_PROBABILITY:
        body = swap_sides(body)  # with hair over the face the body network reports a back
    hands = run_in_background(lambda: [find_hand(picture, body, side) for side in ("left", "right")])
    face = find_face(picture, body)
    left, right = hands()
    return DetectedPerson(_with_head(body, face) if face.displaced else body, face, left, right)


def _with_head(body: DetectedBody, face: Face) -> DetectedBody:
    """Return the body with its head's landmarks taken from the face; ears are at the face's sides."""
    points = body.points.copy()
    points[: len(_HEAD_FROM_FACE)] = [face.points[list(marks), :2].mean(axis=0) for marks in _HEAD_FROM_FACE]
    return replace(body, points=points)


def degrees_between(first: Degrees, second: float) -> Degrees:
    """Return the angle between two directions in degrees, or between each of many and one, 0 to 180."""
    return abs((first - second + 180) % 360 - 180)


def swap_sides(body: DetectedBody) -> DetectedBody:
    """Return the body as seen from the opposite side: left and right exchanged, depths negated."""
    return replace(
        body,
        points=body.points[OPPOSITE],
        visible=body.visible[OPPOSITE],
        world=body.world[OPPOSITE] * (1.0, 1.0, -1.0),
    )
