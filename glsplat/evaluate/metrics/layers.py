"""The two layers of the networks behind LPIPS, on numpy: pictures are [H, W, C], kernels [k, k, C, O]."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

__all__ = ["convolved", "pooled"]

F32 = NDArray[np.float32]

_BLOCK = 1 << 20  # floats of the windows that are laid out at a time: what a core's cache holds, more or less


def convolved(picture: F32, kernel: F32, bias: F32, stride: int, padding: int) -> F32:
    """Correlation with ``kernel``, zeros around the picture, negative values cut off.

    The windows of a few rows are laid out side by side, so that the work is one product of two matrices.
    """
    side, _, inside, outside = kernel.shape
    padded = np.ascontiguousarray(np.pad(picture, ((padding, padding), (padding, padding), (0, 0))))
    height, width = ((extent - side) // stride + 1 for extent in padded.shape[:2])
    down, across, deep = padded.strides
    windows = as_strided(
        padded,
        (height, width, side, side * inside),  # a row of a window lies in one piece
        (down * stride, across * stride, down, deep),
        writeable=False,
    )
    rows = max(1, min(height, _BLOCK // (width * kernel[..., 0].size)))
    matrix = kernel.reshape(-1, outside)
    laid = np.empty((rows, width, side, side * inside), np.float32)
    out = np.empty((height, width, outside), np.float32)
    for first in range(0, height, rows):
        part = out[first : first + rows]
        block = laid[: len(part)]
        np.copyto(block, windows[first : first + rows])
        np.matmul(block.reshape(-1, len(matrix)), matrix, out=part.reshape(-1, outside))
        part += bias
        np.maximum(part, 0, out=part)
    return out


def pooled(picture: F32, side: int) -> F32:
    """The maximum over windows of ``side`` pixels each way, two pixels apart; windows that stick out are left out."""
    height, width = ((extent - side) // 2 + 1 for extent in picture.shape[:2])
    out = np.full((height, width, picture.shape[2]), -np.inf, np.float32)
    for row in range(side):
        for column in range(side):
            np.maximum(out, picture[row : row + 2 * height - 1 : 2, column : column + 2 * width - 1 : 2], out=out)
    return out
