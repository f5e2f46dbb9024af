"""Hair's own locks on the sides of a head that no picture shows: quilted from the hair that is seen about the face."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.paint.inpaint.quilt import Texture, quilted
from glsplat.extras.authoring.paint.view_sample import FittedPicture
from glsplat.pictures import to_linear

__all__ = ["Strands", "strands_of"]

F64 = NDArray[np.float64]

_TEXEL = 0.0025  # metres
_RADIUS = 0.1  # metres of a head: what turns angles into texels
_LONG = 0.6  # metres from the middle of a head down to where hair may reach
_LOCKS = 0.02  # metres: what is wider is the light on the head, not its hair
_RANGE = 0.5, 1.8  # of brightness
_LIKE, _ASIDE = 0.45, 0.3  # of the way from hair to skin, and beside it: what is nearer is hair


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """Brightness of hair against its surroundings, laid around a head from its crown; ``strands_of`` makes one."""

    texture: Texture  # [down, around]
    middle: F64  # [3] metres, of the round part of the head

    def at(self, where: F64) -> F64:
        """[M] at points [M, 3] of the zero pose."""
        rows, columns = self.texture.shape
        away = where - self.middle
        around = np.arctan2(away[:, 0], -away[:, 2]) / (2 * np.pi) + 0.5  # its seam is before the face
        polar = np.arctan2(np.hypot(away[:, 0], away[:, 2]), away[:, 1])
        down = _RADIUS * np.minimum(polar, np.pi / 2) + np.maximum(-away[:, 1], 0)
        column, row = (around * columns).astype(np.intp) % columns, (down / _TEXEL).astype(np.intp)
        return np.asarray(self.texture[row.clip(0, rows - 1), column], np.float64)


def strands_of(shot: FittedPicture, some: NDArray[np.intp], hair: F64, skin: F64, middle: F64) -> Strands | None:
    """Of the hair that ``shot`` shows about the vertices ``some``; None where that is too little.

    ``hair`` and ``skin`` are square roots of linear colours [3], ``middle`` [3] is that of the round part of the head.
    """
    scale = float(shot.view.joints[0, 2]) / (shot.focal * _TEXEL)
    low, high = (shot.view.pixels[some].min(axis=0), shot.view.pixels[some].max(axis=0))
    first = np.floor(low).astype(np.intp).clip(0, None)
    box = np.s_[first[1] : int(high[1]) + 1, first[0] : int(high[0]) + 1]
    if not shot.mask[box].any():
        return None
    size = tuple(max(1, round(side * scale)) for side in shot.mask[box].shape[::-1])
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    look = np.sqrt(to_linear(cv2.resize(shot.rgb[box], size, interpolation=kind) / 255))
    mask = cv2.resize(shot.mask[box].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    way = (skin - hair) / max(float((skin - hair) @ (skin - hair)), 1e-9)
    along = (look - hair) @ way
    beside = np.linalg.norm(look - hair - along[..., None] * (skin - hair), axis=2)
    like = ((along < _LIKE) & (beside < _ASIDE) & (mask > 0)).astype(np.uint8)
    whole = cv2.morphologyEx(like, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))  # with its glints
    known = cv2.erode(whole, np.ones((5, 5), np.uint8)) > 0  # and without its edges, where skin and room are mixed in
    light = (look**2).mean(axis=2).astype(np.float32)
    weight = known.astype(np.float32)
    sigma = _LOCKS / _TEXEL
    around = cv2.GaussianBlur(light * weight, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-4)
    ratio = np.where(known, (light + 0.003) / (around + 0.003), 1).clip(*_RANGE).astype(np.float32)
    shape = int((_RADIUS * np.pi / 2 + _LONG) / _TEXEL), int(2 * np.pi * _RADIUS / _TEXEL)
    texture = quilted(ratio, known, shape)
    return None if texture is None else Strands(texture / texture.mean(), middle)
