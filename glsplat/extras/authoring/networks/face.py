"""A face: 468 landmarks, and where they are believed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .eye import Eye, eye_between, look_of_eye
from .network import Crop, network, sigmoid
from .person import DetectedBody

__all__ = ["Face", "eye_of", "find_face", "shows_face"]

_FACE = 192  # pixels of the network's input
_ROUNDS = 2
_SURE = 0.9  # of a face that is seen: no other crop is tried
_AGAIN = ((-0.15, 0.85), (0.0, 0.85), (0.15, 0.85), (0.0, 1.15))  # other crops: moved down, in its size, and widened
_FACE_AT_ALL = 0.5  # of a face that may be there, and is not believed yet
_GUESSED = 0.49  # of one whose landmarks lie anywhere: neither the check nor the fit believes it
_ELSEWHERE = tuple((down, aside) for down in (0.0, 0.15, 0.3, 0.45) for aside in (0.0, -0.2, 0.2, -0.4, 0.4))  # sides
_CORNERS = {"right": (33, 133), "left": (263, 362)}  # outer and inner corner of the person's own eye


@dataclass(frozen=True, eq=False)
class Face:
    """What the face network says of one face."""

    points: NDArray[np.float64]
    """[468, 3] of MediaPipe's face mesh: pixels of the picture (first pixel's centre at 0.5), and depth on the
    same scale, away from the camera, zero near the face's middle."""
    presence: float
    """From 0 to 1: that the crop shows a face."""
    crop: Crop
    """The square that the network saw."""
    elsewhere: bool = False
    """It is not where the body's landmarks have it."""


def find_face(picture: NDArray[np.uint8], body: DetectedBody) -> Face:
    """The body's face; ``presence`` says whether it is seen."""
    eyes = body.point("left_eye") - body.point("right_eye")
    middle = (body.point("nose") + (body.point("mouth_left") + body.point("mouth_right")) / 2) / 2
    side = max(float(np.ptp(body.points[:11], axis=0).max()), 1.0)
    crop = Crop(float(middle[0]), float(middle[1]) - 0.1 * side, 2.2 * side, float(np.arctan2(eyes[1], eyes[0])))
    face = _face_in(picture, crop)
    if face.presence > _SURE:
        return face
    tried = [face]
    for down, wider in _AGAIN:  # a hand or a hat at the face, and the first crop may lie badly
        tried.append(_face_in(picture, replace(crop, y=crop.y + down * side, side=wider * crop.side)))
        if tried[-1].presence > _SURE:
            break
    face = max(tried, key=lambda found: found.presence)
    if face.presence < _FACE_AT_ALL or (shown := eyes_shown(picture, face)) == 2:
        return face
    for down, aside in _ELSEWHERE:  # a mask hides the mouth, and a fringe was taken for eyes, the eyes for a mouth
        other = _face_in(picture, replace(crop, x=crop.x + aside * side, y=crop.y + down * side))
        if other.presence > _FACE_AT_ALL and eyes_shown(picture, other) == 2:
            return replace(other, elsewhere=True)
    return face if shown else replace(face, presence=_GUESSED)


def eyes_shown(picture: NDArray[np.uint8], face: Face) -> int:
    """How many of a face's eyes are open, with whites beside a dark iris: landmarks may lie where no eye is."""
    return sum(look_of_eye(picture, eye_of(picture, face, side)).seen for side in _CORNERS)


def _face_in(picture: NDArray[np.uint8], crop: Crop) -> Face:
    """The face that a rough crop shows."""
    for step in range(_ROUNDS):
        marks, presence = _look(picture, crop)
        flat = crop.to_picture(marks[:, :2], _FACE)
        points = np.column_stack([flat, marks[:, 2] * crop.side / _FACE])
        if presence < 0.2 or step == _ROUNDS - 1:
            break
        crop = _around(flat)
    return Face(points, presence, crop)


def shows_face(picture: NDArray[np.uint8], body: DetectedBody) -> float:
    """From 0 to 1: that the body's head, taken as upright, shows its face; whatever side its landmarks are on."""
    head = body.points[:11]
    middle, neck = head.mean(axis=0), (body.point("left_shoulder") + body.point("right_shoulder")) / 2
    side = max(float(np.ptp(head, axis=0).max()), 0.55 * float(np.hypot(*(neck - middle))), 1.0)
    return _look(picture, Crop(float(middle[0]), float(middle[1]), 2 * side))[1]


def eye_of(picture: NDArray[np.uint8], face: Face, side: str) -> Eye:
    """The face's own ``left`` or ``right`` eye, wherever it looks; a closed eye gives a guess."""
    return eye_between(picture, face.points[list(_CORNERS[side]), :2], face.crop.turn)


def _look(picture: NDArray[np.uint8], crop: Crop) -> tuple[NDArray[np.float64], float]:
    """[468, 3] in the crop's pixels, and whether it shows a face."""
    values = sorted(network("face_landmark")(crop.cut(picture, _FACE)), key=len)  # names differ between versions
    return values[1].reshape(468, 3).astype(np.float64), float(sigmoid(values[0])[0])


def _around(points: NDArray[np.float64]) -> Crop:
    """The square that the network is meant to see of these landmarks."""
    eyes = points[263] - points[33]
    turn = float(np.arctan2(eyes[1], eyes[0]))
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    inner = points @ axes.T
    low, high = inner.min(axis=0), inner.max(axis=0)
    middle = ((low + high) / 2) @ axes
    return Crop(float(middle[0]), float(middle[1]), 1.5 * max(float((high - low).max()), 1.0), turn)
