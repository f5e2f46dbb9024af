"""Lids: what a picture shows within an open eye is no skin, though the fitted lids, folded as they are, lie there."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.authoring.faces.open_face import open_face
from glsplat.authoring.fit.body import open_body
from glsplat.authoring.fit.eyes import EyeLook

__all__ = ["lids_of", "within_eyes"]

F64 = NDArray[np.float64]

_MOVED = 0.0015  # metres by which a blink moves what is a lid
_SOFT = 0.25  # of an iris's radius, over which an eye's colours end beyond the lids' edge
_BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")


@lru_cache(maxsize=1)
def lids_of() -> NDArray[np.bool_]:
    """[V] of the open body's vertices: the skin that a blink moves."""
    body, blinks = open_body(), open_face().expressions
    out = np.zeros(len(body.vertices), bool)
    for name in _BLINKS:
        number = blinks.names.index(name)
        some = slice(blinks.starts[number], blinks.starts[number + 1])
        far = np.linalg.norm(blinks.offsets[some], axis=1) > _MOVED
        out[blinks.vertices[some][far]] = True
    return frozen(out & body.skin)


def within_eyes(looks: Mapping[str, EyeLook], pixels: F64) -> F64:
    """[M] from 0 to 1: how surely pixels [M, 2] of the picture lie within an eye that is seen open."""
    out = np.zeros(len(pixels))
    for look in looks.values():
        if look.lids is None:
            continue
        outline = cv2.convexHull(look.lids.astype(np.float32))
        wide = max(_SOFT * look.radius, 0.5)
        near = np.flatnonzero(
            ((pixels > look.lids.min(axis=0) - wide) & (pixels < look.lids.max(axis=0) + wide)).all(axis=1)
        )
        inside = [cv2.pointPolygonTest(outline, tuple(map(float, pixels[k])), True) for k in near]
        out[near] = np.maximum(out[near], (1 + np.array(inside) / wide).clip(0, 1))
    return out
