"""Small work on pictures: linear light, colours between pixels, detail around them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.pictures import to_linear
from glsplat.rotations import component_sums

__all__ = ["bilinear", "busy", "grown", "linear"]

F64 = NDArray[np.float64]

_PATCH, _BUSY = 7, 0.12  # pixels, and the spread of colour in them that is full of detail


def linear(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Of sRGB [..., 3] in 8 bits the linear light."""
    table = to_linear(np.arange(256) / 255).astype(np.float32)
    return np.asarray(table[rgb])


def busy(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """[H, W] the local spread of colour, as a share of what counts as full of detail; ``picture`` is linear light."""
    colour = np.sqrt(picture)  # about as eyes see it
    variance = cv2.blur(colour**2, (_PATCH, _PATCH)) - cv2.blur(colour, (_PATCH, _PATCH)) ** 2
    return np.minimum(np.sqrt(component_sums(np.maximum(variance, 0))) / _BUSY, 1)


def bilinear(picture: NDArray[np.float32], pixels: F64) -> F64:
    """[M, 3] colours of a ``picture`` [H, W, 3] at ``pixels`` [M, 2], those of its edge beyond it."""
    side = 256  # OpenCV's remap wants pictures, of less than 32767 pixels a side
    rows = max(1, -(-len(pixels) // side))
    flat = np.zeros((rows * side, 2), np.float32)
    flat[: len(pixels)] = pixels - 0.5
    x, y = (np.ascontiguousarray(flat[:, axis].reshape(rows, side)) for axis in (0, 1))
    parts = [
        cv2.remap(picture, x[a : a + side], y[a : a + side], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for a in range(0, rows, side)
    ]
    return np.concatenate(parts).reshape(-1, 3)[: len(pixels)].astype(np.float64)


def grown(small: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Labels at the size of a picture of this ``shape``."""
    return cv2.resize(small.astype(np.int16), shape[::-1], interpolation=cv2.INTER_NEAREST).astype(np.intp)
