"""The layers of the networks behind LPIPS, on numpy, and which pixels of a layer can see which of the one before.

Pictures are [H, W, C]. An area is the rows and the columns of a rectangle, each from the first to one past the last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

__all__ = ["Area", "Convolution", "Layer", "Pooling", "Range"]

F32 = NDArray[np.float32]
Range = tuple[int, int]
Area = tuple[Range, Range]

_BLOCK = 1 << 20  # floats of the windows that are laid out at a time: what a core's cache holds, more or less


@dataclass(frozen=True, eq=False)
class Layer:
    """What looks at windows of ``side`` x ``side`` pixels, ``stride`` pixels apart, zeros around the picture."""

    side: int
    stride: int
    padding: int

    def __call__(self, padded: F32) -> F32:
        """One value a window that lies within ``padded``."""
        raise NotImplementedError

    def extent(self, before: int) -> int:
        """Pixels along an axis that had ``before``."""
        return (before + 2 * self.padding - self.side) // self.stride + 1

    def reach(self, changed: Range, before: int) -> Range:
        """Which of its pixels along an axis see any of ``changed``, of ``before``."""
        first = -((self.side - 1 - self.padding - changed[0]) // self.stride)
        last = (changed[1] - 1 + self.padding) // self.stride
        return max(0, first), min(self.extent(before), last + 1)

    def sees(self, wanted: Range) -> Range:
        """What ``wanted`` of its pixels see, along an axis; may stick out of the picture."""
        return wanted[0] * self.stride - self.padding, (wanted[1] - 1) * self.stride - self.padding + self.side


@dataclass(frozen=True, eq=False)
class Convolution(Layer):
    """Correlation with a kernel [k, k, C, O], negative values cut off."""

    kernel: F32
    bias: F32

    def __call__(self, padded: F32) -> F32:
        """The windows of a few rows are laid out side by side, so that the work is one product of two matrices."""
        padded = np.ascontiguousarray(padded)
        side, inside, outside = self.side, *self.kernel.shape[2:]
        height, width = ((extent - side) // self.stride + 1 for extent in padded.shape[:2])
        down, across, deep = padded.strides
        windows = as_strided(
            padded,
            (height, width, side, side * inside),  # a row of a window lies in one piece
            (down * self.stride, across * self.stride, down, deep),
            writeable=False,
        )
        matrix = self.kernel.reshape(-1, outside)
        rows = max(1, min(height, _BLOCK // (width * len(matrix))))
        laid = np.empty((rows, width, side, side * inside), np.float32)
        out = np.empty((height, width, outside), np.float32)
        for first in range(0, height, rows):
            part = out[first : first + rows]
            block = laid[: len(part)]
            np.copyto(block, windows[first : first + rows])
            np.matmul(block.reshape(-1, len(matrix)), matrix, out=part.reshape(-1, outside))
            part += self.bias
            np.maximum(part, 0, out=part)
        return out


@dataclass(frozen=True, eq=False)
class Pooling(Layer):
    """The maximum of each window, a channel at a time."""

    def __call__(self, padded: F32) -> F32:
        """Windows that stick out are left out."""
        height, width = ((extent - self.side) // self.stride + 1 for extent in padded.shape[:2])
        out = np.full((height, width, padded.shape[2]), -np.inf, np.float32)
        down, across = ((count - 1) * self.stride + 1 for count in (height, width))
        for row in range(self.side):
            for column in range(self.side):
                seen = padded[row : row + down : self.stride, column : column + across : self.stride]
                np.maximum(out, seen, out=out)
        return out
