"""Find a face's 468 landmarks, and the probability that they are right; find its eyes, and read their colours."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.networks.network import Crop, network, sigmoid
from glsplat.extras.authoring.networks.person import DetectedBody

_EYE_INPUT_PX = 64  # side of the network's input
_EYE_CROP_FACTOR = 2.3  # side of the crop in widths of the eye
_DEFAULT_IRIS, _DEFAULT_WHITE = (58.0, 42.0, 32.0), (190.0, 182.0, 174.0)  # sRGB of 255, if no eye is visible
_MIN_OPENING_FRACTION = 0.25  # height of a visible eye in widths
_MIN_CONTRAST_FACTOR = 1.9  # brightness of the white on both sides of a visible iris, in that of the iris
_SAMPLES_PER_PX = 4  # in each direction
_IRIS_RADII, _MIN_WHITE_RADII = (0.45, 0.9), 1.15  # in iris radii: between pupil and rim, and beyond the rim
_SHADED_PERCENT = 60  # of the white, by lids and lashes
_INPUT_PX = 192  # side of the network's input
_CROP_ROUNDS = 2  # the second crop comes from the first landmarks
_SURE_PRESENCE = 0.9  # no further crop is tried
_MIN_PRESENCE = 0.5  # eyes are looked for
_GUESSED_PRESENCE = 0.49  # reported for a face without eyes: below the thresholds of the check and the fit
_RETRIES = ((-0.15, 0.85), (0.0, 0.85), (0.15, 0.85), (0.0, 1.15))  # down in sides of the head, and the crop's factor
_DISPLACEMENTS = tuple((down, right) for down in (0.0, 0.15, 0.3, 0.45) for right in (0.0, -0.2, 0.2, -0.4, 0.4))
_EYE_CORNERS = {"right": (33, 133), "left": (263, 362)}  # outer and inner corner of the person's own eye


@dataclass(frozen=True, eq=False)
class Eye:
    """The iris network's result for one eye, in pixels of the picture."""

    iris: F64
    """[5, 2] the centre, then four points on the rim."""
    lids: F64
    """[71, 2] the eye's outline (first 16) and brow."""


@dataclass(frozen=True, eq=False)
class EyeLook:
    """An eye's place and colours in a picture. An invisible eye has default colours, or those of the other one."""

    visible: bool  # open, and not under hair
    iris: F64  # [2] pixels, its centre; NaN if not visible
    radius: float  # pixels of the iris; NaN if not visible
    iris_colour: F64  # [3] RGB of 255
    white_colour: F64  # [3] RGB of 255


def read_eye(picture: NDArray[np.uint8], eye: Eye) -> EyeLook:
    """Return an eye's colours. It is visible if its lids are apart and a dark iris lies between brighter whites."""
    outline, centre = eye.lids[:16], eye.iris[0]
    radius = float(np.linalg.norm(eye.iris[1:] - centre, axis=1).mean())
    hidden = EyeLook(False, np.full(2, np.nan), np.nan, np.array(_DEFAULT_IRIS), np.array(_DEFAULT_WHITE))
    low, high = outline.min(axis=0), outline.max(axis=0)
    opening = _MIN_OPENING_FRACTION * (high[0] - low[0])
    if not np.isfinite(outline).all() or high[1] - low[1] < opening or radius < 1:
        return hidden
    columns, rows = (np.arange(low[k], high[k], 1 / _SAMPLES_PER_PX) for k in (0, 1))
    x, y = np.meshgrid(columns, rows)
    colours = cv2.remap(picture, (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32), cv2.INTER_LINEAR)
    colours = colours.astype(np.float64)
    lids = np.zeros(x.shape, np.uint8)
    cv2.fillConvexPoly(lids, cv2.convexHull(np.round((outline - low) * _SAMPLES_PER_PX).astype(np.int32)), 1)
    far = np.hypot(x - centre[0], y - centre[1]) / radius
    white, dark = (lids > 0) & (far > _MIN_WHITE_RADII), (lids > 0) & (far < _IRIS_RADII[1])
    ring = dark & (far > _IRIS_RADII[0])
    sides = white & (x < centre[0]), white & (x >= centre[0])
    if min(side.sum() for side in (*sides, ring)) < _SAMPLES_PER_PX**2:
        return hidden
    light = colours @ (0.299, 0.587, 0.114)
    whites = min(float(np.percentile(light[side], 80)) for side in sides)
    if whites < _MIN_CONTRAST_FACTOR * max(float(np.percentile(light[dark], 25)), 1.0):
        return hidden
    bright = white & (light >= np.percentile(light[white], _SHADED_PERCENT))
    return EyeLook(True, centre, radius, np.median(colours[ring], axis=0), np.median(colours[bright], axis=0))


@dataclass(frozen=True, eq=False)
class Face:
    """The face network's result for one face."""

    points: F64
    """[468, 3] of MediaPipe's face mesh: pixels of the picture (first pixel's centre at 0.5), and depth on the
    same scale, away from the camera, zero near the face's middle."""
    presence: float
    """Probability that the crop shows a face."""
    crop: Crop
    """The network's input."""
    displaced: bool = False
    """The face was found beside the place where the body's landmarks have it."""


def find_face(picture: NDArray[np.uint8], body: DetectedBody) -> Face:
    """Return the body's face; a low ``presence`` means that it is not shown."""
    eyes = body.point("left_eye") - body.point("right_eye")
    middle = (body.point("nose") + (body.point("mouth_left") + body.point("mouth_right")) / 2) / 2
    side = max(float(np.ptp(body.points[:11], axis=0).max()), 1.0)
    crop = Crop(float(middle[0]), float(middle[1]) - 0.1 * side, 2.2 * side, float(np.arctan2(eyes[1], eyes[0])))
    face = _face_in(picture, crop)
    if face.presence > _SURE_PRESENCE:
        return face
    faces = [face]
    for down, factor in _RETRIES:  # with a hand or a hat at the face the first crop may be off
        faces.append(_face_in(picture, replace(crop, y=crop.y + down * side, side=factor * crop.side)))
        if faces[-1].presence > _SURE_PRESENCE:
            break
    face = max(faces, key=lambda found: found.presence)
    if face.presence < _MIN_PRESENCE or (visible := visible_eyes(picture, face)) == 2:
        return face
    for down, right in _DISPLACEMENTS:  # above a mask the network takes a fringe for eyes and the eyes for a mouth
        other = _face_in(picture, replace(crop, x=crop.x + right * side, y=crop.y + down * side))
        if other.presence > _MIN_PRESENCE and visible_eyes(picture, other) == 2:
            return replace(other, displaced=True)
    return face if visible else replace(face, presence=_GUESSED_PRESENCE)


def visible_eyes(picture: NDArray[np.uint8], face: Face) -> int:
    """Return the number of a face's eyes that are open, with whites beside a dark iris."""
    return sum(read_eye(picture, eye_of(picture, face, side)).visible for side in _EYE_CORNERS)


def _face_in(picture: NDArray[np.uint8], crop: Crop) -> Face:
    """Return the face in a rough crop."""
    for step in range(_CROP_ROUNDS):
        marks, presence = _landmarks(picture, crop)
        flat = crop.to_picture(marks[:, :2], _INPUT_PX)
        points = np.column_stack([flat, marks[:, 2] * crop.side / _INPUT_PX])
        if presence < 0.2 or step == _CROP_ROUNDS - 1:
            break
        eyes = flat[263] - flat[33]
        crop = Crop.around(flat, float(np.arctan2(eyes[1], eyes[0])), 1.5)
    return Face(points, presence, crop)


def face_probability(picture: NDArray[np.uint8], body: DetectedBody) -> float:
    """Return the probability that the body's head, assumed upright, shows a face, from the front or from behind."""
    head = body.points[:11]
    middle, neck = head.mean(axis=0), (body.point("left_shoulder") + body.point("right_shoulder")) / 2
    side = max(float(np.ptp(head, axis=0).max()), 0.55 * float(np.hypot(*(neck - middle))), 1.0)
    return _landmarks(picture, Crop(float(middle[0]), float(middle[1]), 2 * side))[1]


def eye_of(picture: NDArray[np.uint8], face: Face, side: str) -> Eye:
    """Return the person's own ``left`` or ``right`` eye; a guess if it is closed."""
    corners = face.points[list(_EYE_CORNERS[side]), :2]
    middle, width = corners.mean(axis=0), max(float(np.hypot(*(corners[0] - corners[1]))), 1.0)
    crop = Crop(float(middle[0]), float(middle[1]), _EYE_CROP_FACTOR * width, face.crop.turn)
    lids, iris = sorted(network("iris_landmark")(crop.cut(picture, _EYE_INPUT_PX)), key=len, reverse=True)
    return Eye(
        iris=crop.to_picture(iris.reshape(5, 3)[:, :2].astype(np.float64), _EYE_INPUT_PX),
        lids=crop.to_picture(lids.reshape(71, 3)[:, :2].astype(np.float64), _EYE_INPUT_PX),
    )


def _landmarks(picture: NDArray[np.uint8], crop: Crop) -> tuple[F64, float]:
    """Return landmarks [468, 3] in the crop's input pixels, and the probability that it shows a face."""
    values = sorted(network("face_landmark")(crop.cut(picture, _INPUT_PX)), key=len)  # output names vary by version
    return values[1].reshape(468, 3).astype(np.float64), float(sigmoid(values[0])[0])
