"""Extend a texture beyond a picture from pieces of it sewn together with soft seams (Efros and Freeman 2001)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["quilt"]

Texture = NDArray[np.float32]

_PIECE_SIZES_PX = 24, 18, 13, 9  # the first size with enough known pieces is used
_SEAM_FRACTION = 0.35  # of a piece that overlaps its neighbours
_MIN_KNOWN_FRACTION = 0.85  # of a piece
_MIN_PIECES = 100
_CANDIDATES, _BEST_CANDIDATES = 120, 3  # compared for each place; one of the best is taken at random
_REUSE_PENALTY = 0.3  # variances of the texture, for each earlier use of a piece
_SEED = 5


def quilt(texture: Texture, known: NDArray[np.bool_], shape: tuple[int, int]) -> Texture | None:
    """Return [H, W] of ``shape`` in pieces of ``texture`` [h, w] that are mostly ``known``; None if these are too few.

    The same texture gives the same quilt.
    """
    for size in _PIECE_SIZES_PX:
        if min(texture.shape) < size:
            continue
        share = cv2.boxFilter(known.astype(np.float32), -1, (size, size), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
        whole = share[: texture.shape[0] - size + 1, : texture.shape[1] - size + 1]
        places = np.argwhere(whole > _MIN_KNOWN_FRACTION)
        if len(places) >= _MIN_PIECES:
            return _sew(texture, places, size, shape)
    return None


def _sew(texture: Texture, places: NDArray[np.intp], size: int, shape: tuple[int, int]) -> Texture:
    rng = np.random.default_rng(_SEED)
    seam = max(2, int(_SEAM_FRACTION * size))
    step = size - seam
    ramp = np.minimum(np.arange(1, size + 1) / (seam + 1), 1)
    weight = np.outer(ramp, ramp)
    weight = (weight * weight[::-1, ::-1]).astype(np.float32)  # falls towards all edges
    height, width = (-(-side // step) * step + size for side in shape)
    total, weights = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    pieces = np.lib.stride_tricks.sliding_window_view(texture, (size, size))
    uses = np.zeros(len(places))
    penalty = _REUSE_PENALTY * float(pieces[places[:, 0], places[:, 1]].var())
    for top in range(0, height - size + 1, step):
        for left in range(0, width - size + 1, step):
            some = rng.integers(len(places), size=_CANDIDATES)
            candidates = pieces[places[some, 0], places[some, 1]]
            candidates = candidates[:, :, ::-1] if rng.random() < 0.5 else candidates
            place = np.s_[top : top + size, left : left + size]
            filled = weights[place] > 0
            cost = penalty * uses[some]
            if filled.any():
                difference = candidates[:, filled] - total[place][filled] / weights[place][filled]
                cost = cost + (difference**2).mean(axis=1)
            best = np.argsort(cost, kind="stable")[:_BEST_CANDIDATES]
            piece = int(best[rng.integers(len(best))])
            uses[np.abs(places - places[some[piece]]).max(axis=1) < size // 2] += 1
            total[place] += weight * candidates[piece]
            weights[place] += weight
    return np.asarray((total / np.maximum(weights, 1e-6))[: shape[0], : shape[1]], np.float32)
