"""Find one person's body, face and hands with all networks, and the side of the person that a picture shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64
from glsplat.extras.authoring.compute.threads import run_in_background

from .face import Face, face_probability, find_face
from .hand import Hand, find_hand
from .person import LANDMARKS, DetectedBody, find_body

Degrees = TypeVar("Degrees", float, F64)

SIDES: dict[str, float] = {"front": 0.0, "right": 90.0, "back": 180.0, "left": -90.0}
"""Side of the person that a picture shows -> degrees that they have turned to their own left to show it."""

_MIN_FACE_PROBABILITY = 0.5  # fronts have at least 0.8, backs at most 0.01
_HEAD_FROM_FACE = (  # points of the face mesh whose means replace the head's LANDMARKS, in their order
    *((1,), (362,), (362, 263), (263,), (133,), (133, 33), (33,)),  # nose; left and right eye from its inner corner
    *((454,), (234,), (291,), (61,)),  # ears, mouth's corners
)
_OPPOSITE = [
    LANDMARKS.index(
        name.replace("left", "right") if "left" in name else name.replace("right", "left") if "right" in name else name
    )
    for name in LANDMARKS
]


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
    body = find_body(picture, people)
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
        points=body.points[_OPPOSITE],
        visible=body.visible[_OPPOSITE],
        world=body.world[_OPPOSITE] * (1.0, 1.0, -1.0),
    )
