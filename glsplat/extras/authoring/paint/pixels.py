"""Sample and measure pictures: linear light, bilinear colours, local detail."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.pictures import to_linear
from glsplat.rotations import component_sums

F64 = NDArray[np.float64]

_DETAIL_PATCH_PX = 7
_RELIEF_SIGMA_FRACTION = 0.018  # of the person's height: wider changes of light are shading
_MAX_RELIEF, _RELIEF_ROUNDS = 0.3, 3  # logarithm of brightness; rounds in which what exceeds it is left out
_MEAN_SIGMA_PX = 5.0  # of the smaller picture in which the mean is taken
_MIN_LIGHT = 0.01  # added to linear light: the noise of black cloth is no relief
_FULL_DETAIL_SPREAD = 0.12  # standard deviation of perceptual colour in a patch


def linear_light(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the linear light of sRGB [..., 3] in 8 bits."""
    table = to_linear(np.arange(256) / 255).astype(np.float32)
    return np.asarray(table[rgb])


def detail_of(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return [H, W] the local spread of colour, from 0 to 1, full of detail; ``picture`` is linear light."""
    colour = np.sqrt(picture)  # roughly perceptual
    variance = (
        cv2.blur(colour**2, (_DETAIL_PATCH_PX, _DETAIL_PATCH_PX))
        - cv2.blur(colour, (_DETAIL_PATCH_PX, _DETAIL_PATCH_PX)) ** 2
    )
    return np.minimum(np.sqrt(component_sums(np.maximum(variance, 0))) / _FULL_DETAIL_SPREAD, 1)


def relief_of(picture: NDArray[np.float32], some: NDArray[np.bool_], height: float) -> NDArray[np.float32]:
    """Return [H, W] the logarithm of brightness over its mean nearby; 0 where it is large: prints, straps, buttons.

    ``picture`` is linear light, of which ``some`` pixels count; ``height`` is that of the person in pixels.
    """
    relief = np.zeros(some.shape, np.float32)
    if not some.any():
        return relief
    rows, columns = (np.flatnonzero(some.any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    light, some = np.log(component_sums(picture[box]) + _MIN_LIGHT), some[box]
    sigma = _RELIEF_SIGMA_FRACTION * height
    scale = min(1.0, _MEAN_SIGMA_PX / sigma)
    size = tuple(max(1, round(side * scale)) for side in some.shape[::-1])

    def blurred(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
        return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT))

    here = np.zeros_like(light)
    for _ in range(_RELIEF_ROUNDS):
        some = some & (np.abs(here) < _MAX_RELIEF)
        weight = some.astype(np.float32)
        small = (cv2.resize(values, size, interpolation=cv2.INTER_AREA) for values in (weight * light, weight))
        total, count = (blurred(values, scale * sigma) for values in small)
        here = light - cv2.resize(total / np.maximum(count, 1e-9), light.shape[::-1])
    inside = blurred(some.astype(np.float32), sigma / 4)  # fades out before an edge
    relief[box] = some * here.clip(-_MAX_RELIEF, _MAX_RELIEF) * (2 * inside - 1).clip(0)
    return relief


def bilinear(picture: NDArray[np.float32], pixels: F64) -> F64:
    """Return [M, 3] colours of a ``picture`` [H, W, 3] at ``pixels`` [M, 2]; beyond it, those of its edge."""
    side = 256  # OpenCV's remap takes pictures of fewer than 32767 pixels a side
    rows = max(1, -(-len(pixels) // side))
    flat = np.zeros((rows * side, 2), np.float32)
    flat[: len(pixels)] = pixels - 0.5
    x, y = (np.ascontiguousarray(flat[:, axis].reshape(rows, side)) for axis in (0, 1))
    parts = [
        cv2.remap(picture, x[a : a + side], y[a : a + side], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for a in range(0, rows, side)
    ]
    return np.concatenate(parts).reshape(-1, 3)[: len(pixels)].astype(np.float64)


def upscale_labels(small: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Return labels at the size of a picture of this ``shape``."""
    return cv2.resize(small.astype(np.int16), shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.intp)


def masked_blur(
    picture: NDArray[np.float32], some: NDArray[np.bool_], across: float, down: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return [H, W, C] the mean of ``some`` pixels about each pixel, and [H, W] their weight.

    ``across`` and ``down`` are standard deviations in pixels.
    """
    weight = some.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), across, sigmaY=down)
    mean = cv2.GaussianBlur(picture * weight[..., None], (0, 0), across, sigmaY=down)
    mean = mean.reshape(picture.shape) / np.maximum(total, 1e-9)[..., None]
    return np.asarray(mean, np.float32), np.asarray(total, np.float32)
