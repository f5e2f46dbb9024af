"""What splats' own values are against what a picture of these values shows where they lie: compiled loops.

One tile at a time, so that a picture of several values needs no memory of its own: values are mixed front to back as
colours are (``kernels.draw``), and what is seen at each pixel goes back to the splats by their weights there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.authoring.footprints import ALPHA_MAX
from glsplat.authoring.optimize.compiled import compiled
from glsplat.authoring.optimize.kernels import TILE, _alpha, _edges, _read, _span

__all__ = ["SUMS", "VALUES", "agreed"]

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

VALUES = 6
"""Numbers a splat: its normal 3, two others, 1; all 0 of a splat that faces away."""
SUMS = 8
"""Numbers an entry: five values seen and 1, each by how upright the surface is seen; pixels that count, and all."""

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_CAP = np.float32(ALPHA_MAX)
_FACING = np.float32(0.5)  # of a pixel, at least, that shows what faces the camera: elsewhere one looks through


@compiled
def agreed(
    tiles: I64,
    across: int,
    start: I64,
    splat: I32,
    record: F32,
    box: I32,
    size: tuple[int, int],  # height, width
    least: np.float32,  # of what passes: nothing counts where less passes
    sums: F32,  # [E, SUMS] written
    values: F32,  # [N, VALUES]
    towards: F32,  # [3] unit, to the camera
) -> None:
    """Some tiles of a picture of ``values``."""
    height, width = size
    seen = np.empty((TILE, TILE, VALUES + 1), np.float32)
    passes = np.empty((TILE, TILE), np.float32)
    for tile in tiles:
        left, top, right, bottom = _edges(tile, across, width, height)
        first, last = start[tile], start[tile + 1]
        seen[:], passes[:] = _ZERO, _ONE
        clear = (right - left + 1) * (bottom - top + 1)  # pixels that something passes to
        for entry in range(first, last):
            if not clear:
                sums[entry, 7] = _ZERO
                continue
            i = splat[entry]
            u, v, a, b, c, opacity, q, _, _, _ = _read(record, i)
            n0, n1, n2, n3, n4, n5 = values[i, 0], values[i, 1], values[i, 2], values[i, 3], values[i, 4], values[i, 5]
            total = _ZERO
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y - top, x - left]
                    if before < least:
                        continue
                    dx = np.float32(x) + _HALF - u
                    alpha = min(_alpha(opacity, a, b, c, dx, dy), _CAP)
                    weight = alpha * before
                    passes[y - top, x - left] = before - weight
                    clear -= before - weight < least
                    total += weight
                    seen[y - top, x - left, 0] += weight * n0
                    seen[y - top, x - left, 1] += weight * n1
                    seen[y - top, x - left, 2] += weight * n2
                    seen[y - top, x - left, 3] += weight * n3
                    seen[y - top, x - left, 4] += weight * n4
                    seen[y - top, x - left, 5] += weight * n5
            sums[entry, 7] = total
        _weighed(seen, towards)
        passes[:] = _ONE
        for entry in range(first, last):
            for k in range(SUMS - 1):
                sums[entry, k] = _ZERO
            if sums[entry, 7] == _ZERO:  # hidden, as most are
                continue
            i = splat[entry]
            u, v, a, b, c, opacity, q, _, _, _ = _read(record, i)
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = _ZERO
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y - top, x - left]
                    if before < least:
                        continue
                    dx = np.float32(x) + _HALF - u
                    alpha = min(_alpha(opacity, a, b, c, dx, dy), _CAP)
                    weight = alpha * before
                    passes[y - top, x - left] = before - weight
                    s0 += weight * seen[y - top, x - left, 0]
                    s1 += weight * seen[y - top, x - left, 1]
                    s2 += weight * seen[y - top, x - left, 2]
                    s3 += weight * seen[y - top, x - left, 3]
                    s4 += weight * seen[y - top, x - left, 4]
                    s5 += weight * seen[y - top, x - left, 5]
                    s6 += weight * seen[y - top, x - left, 6]
            sums[entry, 0], sums[entry, 1], sums[entry, 2], sums[entry, 3] = s0, s1, s2, s3
            sums[entry, 4], sums[entry, 5], sums[entry, 6] = s4, s5, s6


@compiled
def _weighed(seen: F32, towards: F32) -> None:
    """From sums over the pixels of a tile to what is seen there, by how upright; rims show much of what is behind."""
    for y in range(TILE):
        for x in range(TILE):
            part = seen[y, x, 5]
            good = part > _FACING
            upright = _ZERO
            if good:
                cosine = seen[y, x, 0] * towards[0] + seen[y, x, 1] * towards[1] + seen[y, x, 2] * towards[2]
                upright = min(max(cosine / part, _ZERO), _ONE) ** 2
            for k in range(5):
                seen[y, x, k] *= upright / max(part, _FACING)
            seen[y, x, 5], seen[y, x, 6] = upright, _ONE if good else _ZERO
