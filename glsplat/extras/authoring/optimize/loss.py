"""The loss of a picture and its gradient: squared error and 1 - SSIM, weighted by trust.

SSIM after Wang et al. 2004: a Gaussian window of 11 pixels, sigma 1.5.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.compiled import compiled

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_ONE, _TWO = np.float32(1), np.float32(2)
_CHANNELS = 4


class Loss(NamedTuple):
    """Errors of a picture against its target, and the gradient of the loss."""

    squares: float  # mean over pixels and channels of trust times the squared error
    slope: F32  # [H, W, 4] of the loss by the picture
    error: F32  # [H, W] sum over channels of trust times the error


def loss_of(picture: F32, target: U8, weight: float, ssim_weight: float, trust: F32 | None = None) -> Loss:
    """Return the loss weight * trust * (sum (picture - target)^2 + ssim_weight * sum (1 - SSIM)) and its slope.

    Sums run over pixels and channels. ``picture`` [H, W, 4] in [0, 1], ``target`` in steps of 1/255, ``trust``
    [H, W]. SSIM is computed only if ``ssim_weight`` is not 0; its slope is weighted by the trust of the changed pixel,
    not of the windows around it.
    """
    x, y = picture.reshape(-1), np.multiply(target, np.float32(1 / 255), dtype=np.float32)
    slope, error = np.empty_like(picture), np.empty(picture.shape[:2], np.float32)
    if ssim_weight:
        moments = [_blurred(one) for one in (picture, picture * picture, picture * y, y, y * y)]
        _by_moments(*(one.reshape(-1) for one in moments))
        by_mean, by_square, by_product = (_blurred(one).reshape(-1) for one in moments[:3])
    else:
        by_mean = by_square = by_product = np.zeros(0, np.float32)
    trusts = np.zeros(0, np.float32) if trust is None else trust.reshape(-1)
    blurred = by_mean, by_square, by_product
    squares = _slopes(x, y.reshape(-1), blurred, trusts, weight, ssim_weight, slope.reshape(-1), error.reshape(-1))
    return Loss(squares / picture.size, slope, error)


@compiled
def _by_moments(mean: F32, square: F32, product: F32, mean_y: F32, square_y: F32) -> None:
    """Overwrite the blurred picture, square and product with the target by the slopes of SSIM by each."""
    for i in range(len(mean)):
        x, y = mean[i], mean_y[i]
        a1, a2 = _TWO * x * y + _C1, _TWO * (product[i] - x * y) + _C2
        b1, b2 = x * x + y * y + _C1, square[i] + square_y[i] - x * x - y * y + _C2
        inverse = _ONE / (b1 * b2)
        ssim = a1 * a2 * inverse
        by_product, by_square = _TWO * a1 * inverse, -ssim / b2
        mean[i] = _TWO * (y * a2 * inverse - x * ssim / b1) - by_product * y - _TWO * x * by_square
        square[i], product[i] = by_square, by_product


@compiled
def _slopes(
    x: F32, y: F32, blurred: tuple[F32, F32, F32], trust: F32, share: float, ssim_weight: float, slope: F32, error: F32
) -> float:
    """Write slope and error; return the sum of squared errors."""
    by_mean, by_square, by_product = blurred
    weight, one = np.float32(ssim_weight), np.float32(share)
    total = 0.0
    for pixel in range(len(error)):
        wrong = np.float32(0)
        trusted = trust[pixel] if len(trust) else _ONE
        factor = one * trusted
        for i in range(_CHANNELS * pixel, _CHANNELS * pixel + _CHANNELS):
            miss = x[i] - y[i]
            wrong += abs(miss)
            total += trusted * miss * miss
            down = _TWO * miss
            if len(by_mean):
                down -= weight * (by_mean[i] + _TWO * x[i] * by_square[i] + y[i] * by_product[i])
            slope[i] = factor * down
        error[pixel] = trusted * wrong
    return total


def _blurred(values: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(values, (11, 11), 1.5, borderType=cv2.BORDER_CONSTANT), np.float32)
