"""SSIM (Wang et al. 2004): local means, deviations and correlations under a Gaussian window."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError

from .pixels import WHOLE, Box, checked

_SIGMA, _RADIUS = 1.5, 5  # pixels: the paper's window of 11 x 11
_C1, _C2 = 0.01**2, 0.03**2  # for a peak of 1


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
