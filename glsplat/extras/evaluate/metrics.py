"""Measures of the difference of two pictures [H, W, 3] in [0, 1]: L1, PSNR, SSIM and FLIP.

SSIM (Wang et al. 2004) has local means, deviations and correlations under a Gaussian window. FLIP (Andersson et al.
2020) is the visible difference of two alternating pictures, by NVIDIA's own program.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError
from glsplat.optional import require_package

Box = tuple[slice, slice]  # rows and columns of a picture

WHOLE: Box = (slice(None), slice(None))

_FINEST = 1e-30  # lower bound of a mean square

_SIGMA, _RADIUS = 1.5, 5  # pixels: the paper's window of 11 x 11
_C1, _C2 = 0.01**2, 0.03**2  # for a peak of 1


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


def ssim_map(picture: NDArray[np.floating], truth: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return SSIM around each pixel by channel [H, W, 3]; within 5 pixels of the border it is approximate."""
    x, y = (one.astype(np.float64) for one in checked(picture, truth))
    mx, my = _blur(x), _blur(y)
    cross = mx * my
    squares = mx * mx + my * my
    top = (2 * cross + _C1) * (2 * (_blur(x * y) - cross) + _C2)
    return np.asarray(top / ((squares + _C1) * (_blur(x * x) + _blur(y * y) - squares + _C2)))


def ssim(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE) -> float:
    """Return the mean SSIM over ``box`` without the 5 pixels along the picture's border.

    Equals scikit-image's ``structural_similarity`` with gaussian_weights, sigma 1.5, use_sample_covariance False.
    Raises GlsplatError if no pixels are left.
    """
    return inner_mean(ssim_map(picture, truth), box)


def inner_mean(local: NDArray[np.float64], box: Box = WHOLE) -> float:
    """Return the mean over ``box`` of a map [H, W, 3] of ``ssim_map``; see ``ssim``."""
    height, width = local.shape[:2]
    rows, columns = (
        slice(max(start, _RADIUS), max(min(stop, length - _RADIUS), 0))
        for length, (start, stop, _) in ((n, part.indices(n)) for n, part in zip((height, width), box, strict=True))
    )
    inside = local[rows, columns]
    if not inside.size:
        raise GlsplatError(f"SSIM needs pixels {_RADIUS} away from the border; this {width}x{height} picture has none")
    return float(inside.mean())


def _blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    side = 2 * _RADIUS + 1
    return np.asarray(cv2.GaussianBlur(image, (side, side), _SIGMA, borderType=cv2.BORDER_REFLECT))


def flip(picture: NDArray[np.floating], truth: NDArray[np.floating], box: Box = WHOLE) -> float:
    """Return mean FLIP over ``box``, for low dynamic range and its default of 67 pixels per degree; 0 is equal.

    Raises GlsplatError if the package flip-evaluator is missing.
    """
    picture, truth = checked(picture, truth)
    require_package("FLIP", "flip_evaluator", "evaluate")
    import flip_evaluator

    pair = [np.ascontiguousarray(one, np.float32) for one in (truth, picture)]
    errors, mean, _ = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False)
    return float(mean) if box == WHOLE else float(np.asarray(errors)[box].mean())
