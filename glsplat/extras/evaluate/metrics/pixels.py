"""L1 and PSNR, and what all measures ask of a pair of pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError

Box = tuple[slice, slice]
"""Rows and columns of a picture."""

WHOLE: Box = (slice(None), slice(None))

_FINEST = 1e-30  # below this a mean square counts as none


def checked(picture: NDArray[Any], truth: NDArray[Any]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """The pair, if it is one: floats [H, W, 3] of one shape, finite, in [0, 1]. Raises GlsplatError."""
    if picture.shape != truth.shape:
        raise GlsplatError(f"pictures to compare need one shape, not {picture.shape} and {truth.shape}")
    for one in (picture, truth):
        if one.ndim != 3 or one.shape[2] != 3 or not one.size or not np.issubdtype(one.dtype, np.floating):
            raise GlsplatError(f"expected a picture of floats [H, W, 3] in [0, 1], got {one.dtype} {one.shape}")
        if not (one.min() >= 0 and one.max() <= 1):  # also where one is not a number
            raise GlsplatError(f"expected a picture in [0, 1], got values from {one.min():.4g} to {one.max():.4g}")
    return picture, truth


def l1(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE) -> float:
    """Mean absolute difference over ``box`` and the three channels."""
    picture, truth = checked(picture, truth)
    return float(np.abs(picture[box].astype(np.float64) - truth[box]).mean())


def psnr(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE, most: float = 120.0) -> float:
    """Peak signal-to-noise ratio in dB over ``box``; ``most`` for equal pictures."""
    picture, truth = checked(picture, truth)
    return decibel(float(((picture[box].astype(np.float64) - truth[box]) ** 2).mean()), most)


def decibel(mean_square: float, most: float = 120.0) -> float:
    """The PSNR of a mean squared difference, where 1 is white; at most ``most``."""
    return min(most, float(-10 * np.log10(max(mean_square, _FINEST))))
