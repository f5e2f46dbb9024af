"""Find people in a picture, and one person's 33 landmarks and mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64

from .network import Crop, network, sigmoid

LANDMARKS = (
    "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear "
    "mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_pinky "
    "right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee right_knee left_ankle "
    "right_ankle left_heel right_heel left_foot_index right_foot_index"
).split()
"""Names of the 33 landmarks, in order; left and right are the person's own."""
_OTHER_SIDE = {"left": "right", "right": "left"}
OPPOSITE = [LANDMARKS.index("_".join(_OTHER_SIDE.get(word, word) for word in name.split("_"))) for name in LANDMARKS]
"""Index of the landmark on the other side, or of the nose itself, for each landmark."""

_INPUT_PX = 256  # side of both networks' inputs
_CROP_FACTOR = 1.25  # the crop's side in sides of the person's box, as the network was trained
_CROP_ROUNDS = 2  # the second crop is the box of the first mask


@dataclass(frozen=True, eq=False)
class DetectedBody:
    """The body network's result for one person."""

    points: F64
    """[33, 2] pixels of the picture (first pixel's centre at 0.5), in the order of LANDMARKS."""
    visible: F64
    """[33] probability that the landmark is in the picture and not hidden."""
    world: F64
    """[33, 3] metres for a person of average size, from the hips' middle; x right, y down, z away from the camera."""
    presence: float
    """Probability that the crop shows a person."""
    mask: F32
    """[H, W] probability that a pixel shows the person, at a resolution of 256 pixels over the crop."""
    crop: Crop
    """The network's input."""

    def point(self, name: str) -> F64:
        """Return the pixel [2] of the landmark ``name``."""
        return self.points[LANDMARKS.index(name)]


def people_mask(picture: NDArray[np.uint8]) -> F32:
    """Return the probability [256, 256] that people are shown, over the picture's ``enclosing_square``."""
    crop = enclosing_square(picture).cut(picture, _INPUT_PX)
    return network("selfie_segmentation")(crop)[0].reshape(_INPUT_PX, _INPUT_PX)


def enclosing_square(picture: NDArray[np.uint8]) -> Crop:
    """Return the smallest square around the picture."""
    height, width = picture.shape[:2]
    return Crop(width / 2, height / 2, max(height, width))


def find_body(picture: NDArray[np.uint8], people: F32) -> DetectedBody | None:
    """Return the person at the largest patch of ``people`` of ``people_mask``, or None if there is no patch."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((people > 0.5).astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    box = bounds(labels == largest)
    corners = enclosing_square(picture).to_picture(box.reshape(2, 2), _INPUT_PX)
    return find_body_in_box(picture, corners.ravel())


def find_body_in_box(picture: NDArray[np.uint8], box: F64) -> DetectedBody:
    """Return the person in a rough box (x0, y0, x1, y1) in pixels, which the first mask refines."""
    net = network("pose_landmark_full", ("Identity", "Identity_1", "Identity_2", "Identity_4"))
    for _ in range(_CROP_ROUNDS):
        side = _CROP_FACTOR * max(box[2] - box[0], box[3] - box[1], 1.0)
        crop = Crop((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, side)
        marks, presence, mask, world = net(crop.cut(picture, _INPUT_PX))
        soft = sigmoid(mask.reshape(_INPUT_PX, _INPUT_PX))
        if not (soft > 0.5).any():
            break
        corners = crop.to_picture(bounds(soft > 0.5).reshape(2, 2), _INPUT_PX)
        box = corners.ravel()
    rows = marks.reshape(39, 5)[:33].astype(np.float64)
    return DetectedBody(
        points=crop.to_picture(rows[:, :2], _INPUT_PX),
        visible=sigmoid(rows[:, 3].astype(np.float32)).astype(np.float64),
        world=world.reshape(39, 3)[:33].astype(np.float64),
        presence=float(presence[0]),
        mask=crop.paste(soft, picture.shape[:2]),
        crop=crop,
    )


def bounds(mask: NDArray[np.bool_]) -> F64:
    """Return the box (x0, y0, x1, y1) of the set pixels of [H, W], from edge to edge; zeros for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return np.zeros(4)
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
