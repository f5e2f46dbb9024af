"""Remove shadows that arms cast on the trunk: cloth below an arm darker than the same cloth beyond."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.paint.picture_layers.fill import disc
from glsplat.extras.authoring.paint.pixels import masked_blur
from glsplat.extras.authoring.paint.ramps import ramp

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]

_SEARCH_HEIGHT_PX = 360.0  # of the person, where shadows are searched
# fractions of the height
_SHADOW_DOWN_FRACTION, _SHADOW_ASIDE_FRACTION = 0.08, 0.02  # reach of a shadow below an arm, and to its sides
_GRAIN_FRACTION = 0.01  # finer detail is the cloth's pattern
_LIT_ACROSS_FRACTION, _LIT_DOWN_FRACTION = 0.02, 0.03  # from the shadow to the lit cloth it is compared with
_SHADOW_RATIO, _MAX_SHADOW_RATIO = 2.2, 2.6  # lit over shaded: surely a shadow up to the first, none from the second on
_HUE_TOLERANCE = 0.02  # of shares of red, green and blue, for the same cloth
_MIN_PX = 20
_MIN_WEIGHT = 1e-4  # of blurred pixels


def shadow_gain(picture: Picture, shown: Mask, arms: Mask, height: float) -> Picture:
    """Return [H, W] the factor that removes arms' shadows from the trunk in ``picture`` [H, W, 3], linear light.

    ``shown`` is where the picture shows the trunk, ``arms`` where it shows arms before it; ``height`` is the person's
    in pixels. 1 where there is no shadow.
    """
    scale = min(1.0, _SEARCH_HEIGHT_PX / height)
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    before, mine = (cv2.resize(some.astype(np.float32), size, interpolation=cv2.INTER_AREA) for some in (arms, shown))
    high = height * scale
    down, aside = max(1, round(_SHADOW_DOWN_FRACTION * high)), max(1, round(_SHADOW_ASIDE_FRACTION * high))
    below = cv2.dilate((before > 0.5).astype(np.uint8), np.ones((down, 1), np.uint8), anchor=(0, down - 1))
    shaded = (cv2.dilate(below, disc(aside)) > 0) & (mine > 0.99)
    lit = (mine > 0.99) & ~shaded
    ones = np.ones(picture.shape[:2], np.float32)
    if (before > 0.5).sum() < _MIN_PX or shaded.sum() < _MIN_PX or lit.sum() < _MIN_PX:
        return ones
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    own, near = masked_blur(small, shaded, _GRAIN_FRACTION * high, _GRAIN_FRACTION * high)
    cloth, far = masked_blur(small, lit, _LIT_ACROSS_FRACTION * high, _LIT_DOWN_FRACTION * high)
    light, full = own.mean(axis=2) + 1e-4, cloth.mean(axis=2) + 1e-4
    hue = np.abs(own / (3 * light[..., None]) - cloth / (3 * full[..., None])).max(axis=2)
    ratio = full / light
    likeness = ramp(ratio, _MAX_SHADOW_RATIO, _SHADOW_RATIO) * (2 - hue / _HUE_TOLERANCE).clip(0, 1)
    some = shaded & (near > _MIN_WEIGHT) & (far > _MIN_WEIGHT)
    gain = np.where(some, 1 + likeness * np.maximum(ratio - 1, 0), 1).astype(np.float32)
    # pixels at an arm's edge are as shaded as those beside it
    edge, edge_weight = masked_blur(gain[..., None], some, _GRAIN_FRACTION * high, _GRAIN_FRACTION * high)
    gain = np.where(shaded | (edge_weight < _MIN_WEIGHT), gain, edge[..., 0])
    grown = cv2.resize(gain, picture.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.where(shown, grown, ones)
