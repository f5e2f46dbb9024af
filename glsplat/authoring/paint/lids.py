"""Lids: what a picture shows within an open eye is no skin, though the fitted lids, folded as they are, lie there."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.eyes import EYE_SIDES, EyeLook, eyeball

__all__ = ["lids_of", "within_eyes"]

F64 = NDArray[np.float64]

_NEAR = 0.01  # metres from an eyeball
_SOFT = 0.7  # pixels beyond the lids' edge over which an eye ends


@lru_cache(maxsize=1)
def lids_of() -> NDArray[np.bool_]:
    """[V] of the open body's vertices: the skin about the eyeballs, lids and what they fold into."""
    body = open_body()
    eyes = [eyeball(body, side) for side in EYE_SIDES]
    away = np.min([np.linalg.norm(body.vertices - eye.centre, axis=1) - eye.radius for eye in eyes], axis=0)
    return frozen(body.skin & (away < _NEAR))


def within_eyes(looks: Mapping[str, EyeLook], pixels: F64) -> F64:
    """[M] from 0 to 1: how surely pixels [M, 2] of the picture lie within an eye that is seen open."""
    out = np.zeros(len(pixels))
    for look in looks.values():
        if look.lids is None:
            continue
        outline = cv2.convexHull(look.lids.astype(np.float32))
        near = np.flatnonzero(
            ((pixels > look.lids.min(axis=0) - _SOFT) & (pixels < look.lids.max(axis=0) + _SOFT)).all(axis=1)
        )
        inside = [cv2.pointPolygonTest(outline, tuple(map(float, pixels[k])), True) for k in near]
        out[near] = np.maximum(out[near], ((np.array(inside) + _SOFT) / _SOFT).clip(0, 1))
    return out
