"""A person in a picture: where people are at all, and one person's 33 landmarks and mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .network import Crop, network, sigmoid

__all__ = ["LANDMARKS", "DetectedBody", "body_in", "bounds", "find_body", "people_mask"]

LANDMARKS = (
    "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear "
    "mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_pinky "
    "right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee right_knee left_ankle "
    "right_ankle left_heel right_heel left_foot_index right_foot_index"
).split()
"""Names of the 33 landmarks, in order. Left and right are the person's own."""

_SIDE = 256  # pixels of both networks' input
_MARGIN = 1.25  # the crop's side in sides of the person's box, as the network was trained
_ROUNDS = 2  # the second crop comes from the first mask


@dataclass(frozen=True, eq=False)
class DetectedBody:
    """What the body network says of one person."""

    points: NDArray[np.float64]
    """[33, 2] pixels of the picture (first pixel's centre at 0.5), in the order of LANDMARKS."""
    visible: NDArray[np.float64]
    """[33] from 0 to 1: the network's belief that the landmark is in the picture and not hidden."""
    world: NDArray[np.float64]
    """[33, 3] metres of an average person, hips' middle at the origin; x right and y down in the picture, z away."""
    presence: float
    """From 0 to 1: that there is a person in the crop at all."""
    mask: NDArray[np.float32]
    """[H, W] from 0 to 1: the person; as coarse as 256 pixels over the crop."""
    crop: Crop
    """The square that the network saw."""

    def point(self, name: str) -> NDArray[np.float64]:
        """[2] the landmark of this name."""
        return self.points[LANDMARKS.index(name)]


def people_mask(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """[256, 256] from 0 to 1: where people are. The whole picture in its middle, its longer side from edge to edge."""
    return network("selfie_segmentation")(whole(picture).cut(picture, _SIDE))[0].reshape(_SIDE, _SIDE)


def whole(picture: NDArray[np.uint8]) -> Crop:
    """The smallest square around the picture."""
    height, width = picture.shape[:2]
    return Crop(width / 2, height / 2, max(height, width))


def find_body(picture: NDArray[np.uint8], people: NDArray[np.float32] | None = None) -> DetectedBody | None:
    """The person whom the largest patch of ``people`` (default: ``people_mask``) shows; None where there is none."""
    mask = people_mask(picture) if people is None else people
    count, labels, stats, _ = cv2.connectedComponentsWithStats((mask > 0.5).astype(np.uint8))
    if count < 2:
        return None
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    box = bounds(labels == largest)
    corners = whole(picture).to_picture(box.reshape(2, 2), _SIDE)
    return body_in(picture, corners.ravel())


def body_in(picture: NDArray[np.uint8], box: NDArray[np.float64]) -> DetectedBody:
    """The person in a box (x0, y0, x1, y1) of the picture's pixels. The box may be rough: it is found again."""
    net = network("pose_landmark_full", ("Identity", "Identity_1", "Identity_2", "Identity_4"))
    for _ in range(_ROUNDS):
        crop = Crop((box[0] + box[2]) / 2, (box[1] + box[3]) / 2, _MARGIN * max(box[2] - box[0], box[3] - box[1], 1.0))
        marks, presence, mask, world = net(crop.cut(picture, _SIDE))
        soft = sigmoid(mask.reshape(_SIDE, _SIDE))
        if not (soft > 0.5).any():
            break
        corners = crop.to_picture(bounds(soft > 0.5).reshape(2, 2), _SIDE)
        box = corners.ravel()
    rows = marks.reshape(39, 5)[:33].astype(np.float64)
    return DetectedBody(
        points=crop.to_picture(rows[:, :2], _SIDE),
        visible=sigmoid(rows[:, 3].astype(np.float32)).astype(np.float64),
        world=world.reshape(39, 3)[:33].astype(np.float64),
        presence=float(presence[0]),
        mask=crop.paste(soft, picture.shape[:2]),
        crop=crop,
    )


def bounds(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(x0, y0, x1, y1) around what is set in [H, W], from pixel edge to pixel edge; zeros where nothing is."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return np.zeros(4)
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
