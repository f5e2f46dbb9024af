"""Find an eye's iris and lids, and read its colours from a picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64

from .network import Crop, network

_INPUT_PX = 64  # side of the network's input
_CROP_FACTOR = 2.3  # side of the crop in widths of the eye
_DEFAULT_IRIS, _DEFAULT_WHITE = (58.0, 42.0, 32.0), (190.0, 182.0, 174.0)  # sRGB of 255, if no eye is visible
_MIN_OPENING_FRACTION = 0.25  # height of a visible eye in widths
_MIN_CONTRAST_FACTOR = 1.9  # brightness of the white on both sides of a visible iris, in that of the iris
_SAMPLES_PER_PX = 4  # in each direction
_IRIS_RADII, _MIN_WHITE_RADII = (0.45, 0.9), 1.15  # in iris radii: between pupil and rim, and beyond the rim
_SHADED_PERCENT = 60  # of the white, by lids and lashes


@dataclass(frozen=True, eq=False)
class Eye:
    """The iris network's result for one eye, in pixels of the picture."""

    iris: F64
    """[5, 2] the centre, then four points on the rim."""
    lids: F64
    """[71, 2] the eye's outline (first 16) and brow."""
    crop: Crop


@dataclass(frozen=True, eq=False)
class EyeLook:
    """An eye's place and colours in a picture. An invisible eye has default colours, or those of the other one."""

    visible: bool  # open, and not under hair
    iris: F64  # [2] pixels, its centre; NaN if not visible
    radius: float  # pixels of the iris; NaN if not visible
    iris_colour: F64  # [3] RGB of 255
    white_colour: F64  # [3] RGB of 255


def find_eye(picture: NDArray[np.uint8], corners: F64, turn: float) -> Eye:
    """Return the eye with ``corners`` [2, 2] in pixels on a head that leans by ``turn`` radians; a guess if closed."""
    middle, width = corners.mean(axis=0), max(float(np.hypot(*(corners[0] - corners[1]))), 1.0)
    crop = Crop(float(middle[0]), float(middle[1]), _CROP_FACTOR * width, turn)
    lids, iris = sorted(network("iris_landmark")(crop.cut(picture, _INPUT_PX)), key=len, reverse=True)
    return Eye(
        iris=crop.to_picture(iris.reshape(5, 3)[:, :2].astype(np.float64), _INPUT_PX),
        lids=crop.to_picture(lids.reshape(71, 3)[:, :2].astype(np.float64), _INPUT_PX),
        crop=crop,
    )


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
