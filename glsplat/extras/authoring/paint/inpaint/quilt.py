"""More of a texture than a picture shows, from pieces of it sewn together with soft seams (Efros and Freeman 2001)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["quilted"]

Texture = NDArray[np.float32]

_PIECES = 24, 18, 13, 9  # pixels a side, the first that is found often enough
_SEAM = 0.35  # share of a piece that lies over its neighbours
_WHOLE = 0.85  # share of a piece that is known
_FEWEST = 100  # places that pieces are taken from
_TRIED, _BEST = 120, 3  # pieces that are compared for each place; one of the best is taken
_TIRED = 0.3  # variances of the texture that a piece is thought worse by for each time it was taken
_SEED = 5


def quilted(texture: Texture, known: NDArray[np.bool_], shape: tuple[int, int]) -> Texture | None:
    """[H, W] of ``shape`` in pieces of ``texture`` [h, w] that are mostly ``known``; None where these are too few.

    The same texture gives the same quilt.
    """
    for size in _PIECES:
        if min(texture.shape) < size:
            continue
        share = cv2.boxFilter(known.astype(np.float32), -1, (size, size), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
        rows, columns = np.nonzero(share[: texture.shape[0] - size + 1, : texture.shape[1] - size + 1] > _WHOLE)
        if len(rows) >= _FEWEST:
            return _sewn(texture, np.stack([rows, columns], axis=1), size, shape)
    return None


def _sewn(texture: Texture, places: NDArray[np.intp], size: int, shape: tuple[int, int]) -> Texture:
    rng = np.random.default_rng(_SEED)
    seam = max(2, int(_SEAM * size))
    step = size - seam
    ramp = np.minimum(np.arange(1, size + 1) / (seam + 1), 1)
    weight = np.outer(ramp, ramp)
    weight = (weight * weight[::-1, ::-1]).astype(np.float32)  # falls towards all edges
    height, width = (-(-side // step) * step + size for side in shape)
    total, sure = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    pieces = np.lib.stride_tricks.sliding_window_view(texture, (size, size))
    taken = np.zeros(len(places))
    dull = _TIRED * float(pieces[places[:, 0], places[:, 1]].var())
    for top in range(0, height - size + 1, step):
        for left in range(0, width - size + 1, step):
            some = rng.integers(len(places), size=_TRIED)
            tried = pieces[places[some, 0], places[some, 1]]
            flip = rng.random() < 0.5
            tried = tried[:, :, ::-1] if flip else tried
            there = np.s_[top : top + size, left : left + size]
            laid = sure[there] > 0
            off = dull * taken[some]
            if laid.any():
                off = off + ((tried[:, laid] - total[there][laid] / sure[there][laid]) ** 2).mean(axis=1)
            best = np.argsort(off, kind="stable")[:_BEST]
            piece = int(best[rng.integers(len(best))])
            taken[np.abs(places - places[some[piece]]).max(axis=1) < size // 2] += 1
            total[there] += weight * tried[piece]
            sure[there] += weight
    return np.asarray((total / np.maximum(sure, 1e-6))[: shape[0], : shape[1]], np.float32)
