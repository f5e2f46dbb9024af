"""Linear light and sRGB, of numbers from 0 to 1 (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["to_linear", "to_srgb"]

F64 = NDArray[np.float64]


def to_linear(srgb: F64) -> F64:
    """Linear light of sRGB values, any shape."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: F64) -> F64:
    """sRGB of linear light, clipped to [0, 1]."""
    light = np.clip(linear, 0.0, 1.0)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
