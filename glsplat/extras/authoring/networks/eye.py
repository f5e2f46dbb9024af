"""An eye: its iris and lids, and what a picture says of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .network import Crop, network

__all__ = ["Eye", "EyeLook", "eye_between", "look_of_eye"]

F64 = NDArray[np.float64]

_EYE = 64  # pixels of the network's input
_WIDER = 2.3  # times as wide as the eye is what it sees
_BROWN, _WHITE = (58.0, 42.0, 32.0), (190.0, 182.0, 174.0)  # of 255: where no eye is seen
_OPEN = 0.25  # a seen eye's height in widths
_CONTRAST = 1.9  # brightness of a seen eye's white on both sides of the iris, in that of the iris
_SAMPLES = 4  # a pixel, each way
_RING, _SURROUND = (0.45, 0.9), 1.15  # iris radii: where the iris shows its colour, and where the white begins
_BRIGHTEST = 60  # percent of the white that lids and lashes shade


@dataclass(frozen=True, eq=False)
class Eye:
    """What the iris network says of one eye; pixels of the picture."""

    iris: NDArray[np.float64]
    """[5, 2] its centre, then four points on its rim."""
    lids: NDArray[np.float64]
    """[71, 2] the eye's outline (the first 16), and the brow."""
    crop: Crop


@dataclass(frozen=True, eq=False)
class EyeLook:
    """What a picture says of one eye. The colours are to be used in any case: of an unseen eye they are the other's."""

    seen: bool  # open, and no hair over it
    iris: F64  # [2] pixels, its centre; NaN where it is not seen
    radius: float  # pixels of the iris; NaN where it is not seen
    iris_colour: F64  # [3] RGB of 255
    white_colour: F64  # [3] RGB of 255


def eye_between(picture: NDArray[np.uint8], corners: F64, turn: float) -> Eye:
    """The eye with ``corners`` [2, 2] in pixels on a head that leans by ``turn`` radians; of a closed eye a guess."""
    middle, width = corners.mean(axis=0), max(float(np.hypot(*(corners[0] - corners[1]))), 1.0)
    crop = Crop(float(middle[0]), float(middle[1]), _WIDER * width, turn)
    lids, iris = sorted(network("iris_landmark")(crop.cut(picture, _EYE)), key=len, reverse=True)
    return Eye(
        iris=crop.to_picture(iris.reshape(5, 3)[:, :2].astype(np.float64), _EYE),
        lids=crop.to_picture(lids.reshape(71, 3)[:, :2].astype(np.float64), _EYE),
        crop=crop,
    )


def look_of_eye(picture: NDArray[np.uint8], eye: Eye) -> EyeLook:
    """One eye alone. It is seen where its lids are apart and a dark iris lies between brighter whites."""
    outline, centre = eye.lids[:16], eye.iris[0]
    radius = float(np.linalg.norm(eye.iris[1:] - centre, axis=1).mean())
    hidden = EyeLook(False, np.full(2, np.nan), np.nan, np.array(_BROWN), np.array(_WHITE))
    low, high = outline.min(axis=0), outline.max(axis=0)
    if not np.isfinite(outline).all() or high[1] - low[1] < _OPEN * (high[0] - low[0]) or radius < 1:
        return hidden
    columns, rows = (np.arange(low[k], high[k], 1 / _SAMPLES) for k in (0, 1))
    x, y = np.meshgrid(columns, rows)
    colours = cv2.remap(picture, (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32), cv2.INTER_LINEAR)
    colours = colours.astype(np.float64)
    lids = np.zeros(x.shape, np.uint8)
    cv2.fillConvexPoly(lids, cv2.convexHull(np.round((outline - low) * _SAMPLES).astype(np.int32)), 1)
    far = np.hypot(x - centre[0], y - centre[1]) / radius
    white, ring = (lids > 0) & (far > _SURROUND), (lids > 0) & (far > _RING[0]) & (far < _RING[1])
    dark = (lids > 0) & (far < _RING[1])
    sides = white & (x < centre[0]), white & (x >= centre[0])
    if min(side.sum() for side in (*sides, ring)) < _SAMPLES**2:
        return hidden
    light = colours @ (0.299, 0.587, 0.114)
    whites = min(float(np.percentile(light[side], 80)) for side in sides)
    if whites < _CONTRAST * max(float(np.percentile(light[dark], 25)), 1.0):
        return hidden
    bright = white & (light >= np.percentile(light[white], _BRIGHTEST))
    return EyeLook(True, centre, radius, np.median(colours[ring], axis=0), np.median(colours[bright], axis=0))
