"""One person, read by all networks: body, face and hands, and which side of the person the picture shows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.threads import run_in_background

from .face import Face, find_face, shows_face
from .hand import Hand, find_hand
from .person import LANDMARKS, DetectedBody, find_body

__all__ = ["DetectedPerson", "find_person", "swapped"]

_SURE = 0.9  # of a face: fronts give 0.98 and more, backs 0.01 and less
_HEAD = (  # of the face mesh, in the order of LANDMARKS
    *((1,), (362,), (362, 263), (263,), (133,), (133, 33), (33,)),  # nose; left and right eye from within
    *((454,), (234,), (291,), (61,)),  # ears, mouth's corners
)
_OTHER = [
    LANDMARKS.index(
        name.replace("left", "right") if "left" in name else name.replace("right", "left") if "right" in name else name
    )
    for name in LANDMARKS
]


@dataclass(frozen=True, eq=False)
class DetectedPerson:
    """What the networks say of one person."""

    body: DetectedBody
    face: Face
    """Its ``presence`` is near 0 in a picture from behind."""
    left_hand: Hand
    right_hand: Hand

    @property
    def turn(self) -> float:
        """Radians the shoulders are turned from facing the camera: 0 in front, about pi from behind."""
        across = self.body.world[LANDMARKS.index("left_shoulder")] - self.body.world[LANDMARKS.index("right_shoulder")]
        return float(np.arctan2(across[2], across[0]))


def find_person(picture: NDArray[np.uint8], people: NDArray[np.float32] | None = None) -> DetectedPerson | None:
    """The largest person in an RGB picture, or None. ``people`` is ``people_mask(picture)`` where it is known."""
    body = find_body(picture, people)
    if body is None:
        return None
    mirrored = body.point("left_shoulder")[0] < body.point("right_shoulder")[0]
    if mirrored and shows_face(picture, body) > _SURE:
        body = swapped(body)  # hair over the face, and the body network takes the person for one seen from behind
    hands = run_in_background(lambda: [find_hand(picture, body, side) for side in ("left", "right")])
    face = find_face(picture, body)
    left, right = hands()
    return DetectedPerson(_with_head(body, face) if face.elsewhere else body, face, left, right)


def _with_head(body: DetectedBody, face: Face) -> DetectedBody:
    """The body with the landmarks of its head where the face has them; ears are at the face's sides."""
    points = body.points.copy()
    points[: len(_HEAD)] = [face.points[list(marks), :2].mean(axis=0) for marks in _HEAD]
    return replace(body, points=points)


def swapped(body: DetectedBody) -> DetectedBody:
    """The same outline seen from the other side: left and right change names, near and far change places."""
    return replace(
        body,
        points=body.points[_OTHER],
        visible=body.visible[_OTHER],
        world=body.world[_OTHER] * (1.0, 1.0, -1.0),
    )
