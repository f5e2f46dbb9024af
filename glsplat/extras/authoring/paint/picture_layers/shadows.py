"""Shadows that arms cast on the trunk they lie before: cloth below an arm that is darker than the same cloth beyond."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.paint.picture_layers.fill import disc

__all__ = ["brightening"]

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]

_SMALL = 360.0  # pixels of the person's height that are looked at
_DOWN, _ASIDE = 0.08, 0.02  # of it: so far below an arm its shadow reaches, and to its sides
_GRAIN = 0.01  # of it: what is finer is the cloth's pattern
_BEYOND = 0.02, 0.03  # of it, across and down: how near to the shadow the cloth is taken from
_MOST = 2.2, 2.6  # times that lit cloth is as bright as shaded: up to the first it is a shadow, from the second on not
_HUE = 0.02  # shares of red, green and blue that are the same cloth
_FEWEST = 20  # pixels
_LITTLE = 1e-4  # of what is blurred: less is nothing


def brightening(picture: Picture, shown: Mask, arms: Mask, height: float) -> Picture:
    """[H, W] how many times as bright as in ``picture`` [H, W, 3], linear light, the trunk is without arms' shadows.

    ``shown`` is where the picture shows the trunk, ``arms`` where arms that lie before it; ``height`` is the person's
    in pixels. 1 where there is no shadow.
    """
    scale = min(1.0, _SMALL / height)
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    before, mine = (cv2.resize(some.astype(np.float32), size, interpolation=cv2.INTER_AREA) for some in (arms, shown))
    high = height * scale
    down, aside = max(1, round(_DOWN * high)), max(1, round(_ASIDE * high))
    below = cv2.dilate((before > 0.5).astype(np.uint8), np.ones((down, 1), np.uint8), anchor=(0, down - 1))
    shaded = (cv2.dilate(below, disc(aside)) > 0) & (mine > 0.99)
    lit = (mine > 0.99) & ~shaded
    none = np.ones(picture.shape[:2], np.float32)
    if (before > 0.5).sum() < _FEWEST or shaded.sum() < _FEWEST or lit.sum() < _FEWEST:
        return none
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    own, near = _blurred(small, shaded, _GRAIN * high, _GRAIN * high)
    cloth, far = _blurred(small, lit, _BEYOND[0] * high, _BEYOND[1] * high)
    light, full = own.mean(axis=2) + 1e-4, cloth.mean(axis=2) + 1e-4
    hue = np.abs(own / (3 * light[..., None]) - cloth / (3 * full[..., None])).max(axis=2)
    times = full / light
    alike = ((_MOST[1] - times) / (_MOST[1] - _MOST[0])).clip(0, 1) * (2 - hue / _HUE).clip(0, 1)
    some = shaded & (near > _LITTLE) & (far > _LITTLE)
    gain = np.where(some, 1 + alike * np.maximum(times - 1, 0), 1).astype(np.float32)
    # what lies at an arm's edge is as shaded as what is beside it
    edge, sure = _blurred(gain[..., None], some, _GRAIN * high, _GRAIN * high)
    gain = np.where(shaded | (sure < _LITTLE), gain, edge[..., 0])
    grown = cv2.resize(gain, picture.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    return np.where(shown, grown, none)


def _blurred(picture: Picture, some: Mask, across: float, down: float) -> tuple[Picture, Picture]:
    """[H, W, C] the mean about each pixel of ``some``, and [H, W] how many of them there were."""
    weight = some.astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), across, sigmaY=down)
    mean = cv2.GaussianBlur(picture * weight[..., None], (0, 0), across, sigmaY=down)
    mean = mean.reshape(picture.shape) / np.maximum(total, 1e-9)[..., None]
    return np.asarray(mean, np.float32), np.asarray(total, np.float32)
