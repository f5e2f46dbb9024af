"""Light of a condition: dims or tints the finished picture of an avatar with baked light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FULL = (1.0, 1.0, 1.0)
"""No change."""

_GAMMA = 2.2  # of the display: a light factor f multiplies bytes by f ** (1 / 2.2)


def dim(images: NDArray[np.uint8], light: tuple[float, float, float]) -> None:
    """Multiply the light of ``images`` [V, H, W, 4] by ``light`` [3], 0 to 1, linear RGB, in place.

    With a pure power as display curve, a byte's factor does not depend on alpha, so premultiplied edges stay correct.
    sRGB differs by its linear part near black.
    """
    values = np.arange(256)
    for channel, factor in enumerate(light):
        if factor != 1:
            table = np.rint(values * factor ** (1 / _GAMMA)).astype(np.uint8)
            images[..., channel] = table[images[..., channel]]
