"""Continue locks of hair on the unseen sides of a head: quilted from the hair visible about the face."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.paint.inpaint.quilt import Texture, quilt
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_linear

__all__ = ["Strands", "strands_of"]

F64 = NDArray[np.float64]

_TEXEL_M = 0.0025
_HEAD_RADIUS_M = 0.1  # converts angles to texels
_MAX_LENGTH_M = 0.6  # from the middle of a head downwards
_LOCK_M = 0.02  # wider changes of brightness are the light on the head
_BRIGHTNESS_RANGE = 0.5, 1.8
_MAX_ALONG, _MAX_ASIDE = 0.45, 0.3  # of hair, over the distance to skin: towards it, and away from that line
_BRIGHTNESS_BIAS = 0.003  # linear light; keeps ratios of dark hair steady


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """Brightness of hair against its surroundings, around a head from its crown; ``strands_of`` makes one."""

    texture: Texture  # [down, around]
    middle: F64  # [3] metres, of the head's round part

    def at(self, where: F64) -> F64:
        """Return [M] the relative brightness at points [M, 3] of the zero pose."""
        rows, columns = self.texture.shape
        away = where - self.middle
        around = np.arctan2(away[:, 0], -away[:, 2]) / (2 * np.pi) + 0.5  # the seam is at the face
        polar = np.arctan2(np.hypot(away[:, 0], away[:, 2]), away[:, 1])
        down = _HEAD_RADIUS_M * np.minimum(polar, np.pi / 2) + np.maximum(-away[:, 1], 0)
        column, row = (around * columns).astype(np.intp) % columns, (down / _TEXEL_M).astype(np.intp)
        return np.asarray(self.texture[row.clip(0, rows - 1), column], np.float64)


def strands_of(shot: FittedPicture, some: NDArray[np.intp], hair: F64, skin: F64, middle: F64) -> Strands | None:
    """Return the locks of hair that ``shot`` shows about the vertices ``some``; None if it shows too little.

    ``hair`` and ``skin`` are square roots of linear colours [3], ``middle`` [3] that of the head's round part.
    """
    scale = float(shot.view.joints[0, 2]) / (shot.focal * _TEXEL_M)
    low, high = (shot.view.pixels[some].min(axis=0), shot.view.pixels[some].max(axis=0))
    first = np.floor(low).astype(np.intp).clip(0, None)
    box = np.s_[first[1] : int(high[1]) + 1, first[0] : int(high[0]) + 1]
    if not shot.mask[box].any():
        return None
    size = tuple(max(1, round(side * scale)) for side in shot.mask[box].shape[::-1])
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    look = np.sqrt(to_linear(cv2.resize(shot.rgb[box], size, interpolation=kind) / 255))
    mask = cv2.resize(shot.mask[box].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    to_skin = (skin - hair) / max(float((skin - hair) @ (skin - hair)), 1e-9)
    along = (look - hair) @ to_skin
    beside = np.linalg.norm(look - hair - along[..., None] * (skin - hair), axis=2)
    hairy = ((along < _MAX_ALONG) & (beside < _MAX_ASIDE) & (mask > 0)).astype(np.uint8)
    whole = cv2.morphologyEx(hairy, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))  # includes highlights
    known = cv2.erode(whole, np.ones((5, 5), np.uint8)) > 0  # excludes edges mixed with skin and background
    light = (look**2).mean(axis=2).astype(np.float32)
    weight = known.astype(np.float32)
    sigma = _LOCK_M / _TEXEL_M
    around = cv2.GaussianBlur(light * weight, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-4)
    ratio = np.where(known, (light + _BRIGHTNESS_BIAS) / (around + _BRIGHTNESS_BIAS), 1)
    ratio = ratio.clip(*_BRIGHTNESS_RANGE).astype(np.float32)
    shape = int((_HEAD_RADIUS_M * np.pi / 2 + _MAX_LENGTH_M) / _TEXEL_M), int(2 * np.pi * _HEAD_RADIUS_M / _TEXEL_M)
    texture = quilt(ratio, known, shape)
    return None if texture is None else Strands(texture / texture.mean(), middle)
