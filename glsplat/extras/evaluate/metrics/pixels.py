"""L1 and PSNR, and the checks of a pair of pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError

Box = tuple[slice, slice]
"""Rows and columns of a picture."""

WHOLE: Box = (slice(None), slice(None))

_FINEST = 1e-30  # lower bound of a mean square


def checked(picture: NDArray[Any], truth: NDArray[Any]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the pair. Raises GlsplatError unless both are floats [H, W, 3] of one shape, finite, in [0, 1]."""
    if picture.shape != truth.shape:
        raise GlsplatError(f"pictures to compare need one shape, not {picture.shape} and {truth.shape}")
    for one in (picture, truth):
        if one.ndim != 3 or one.shape[2] != 3 or not one.size or not np.issubdtype(one.dtype, np.floating):
            raise GlsplatError(f"expected a picture of floats [H, W, 3] in [0, 1], got {one.dtype} {one.shape}")
        if not (one.min() >= 0 and one.max() <= 1):  # also for NaN
            raise GlsplatError(f"expected a picture in [0, 1], got values from {one.min():.4g} to {one.max():.4g}")
    return picture, truth


def l1(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE) -> float:
    """Return the mean absolute difference over ``box`` and the three channels."""
    picture, truth = checked(picture, truth)
    return float(np.abs(picture[box].astype(np.float64) - truth[box]).mean())


def psnr(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE, most: float = 120.0) -> float:
    """Return the peak signal-to-noise ratio over ``box`` in dB, at most ``most``."""
    picture, truth = checked(picture, truth)
    return decibel(float(((picture[box].astype(np.float64) - truth[box]) ** 2).mean()), most)


def decibel(mean_square: float, most: float = 120.0) -> float:
    """Return the PSNR of a mean squared difference for a peak of 1, in dB, at most ``most``."""
    return min(most, float(-10 * np.log10(max(mean_square, _FINEST))))
