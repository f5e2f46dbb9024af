"""The light of a condition: what is baked into an avatar's colours, dimmed or tinted in the finished picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["FULL", "dim"]

FULL = (1.0, 1.0, 1.0)
"""As the avatar's file has it."""

_GAMMA = 2.2  # of the display: a factor of light is the factor to the power of 1 / 2.2 of a byte


def dim(images: NDArray[np.uint8], light: tuple[float, float, float]) -> None:
    """Multiply the light of ``images`` [V, H, W, 4] by ``light`` [3], 0 to 1, linear RGB, in place.

    Bytes are taken for a power of the light, so that the factor of a byte is the same whatever its alpha: premultiplied
    edges stay what they are. sRGB's curve differs from that by its straight piece near black.
    """
    values = np.arange(256)
    for channel, factor in enumerate(light):
        if factor != 1:
            table = np.rint(values * factor ** (1 / _GAMMA)).astype(np.uint8)
            images[..., channel] = table[images[..., channel]]
