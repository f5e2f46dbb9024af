"""Pictures of splats' values, gathered back to the splats: compiled loops.

The shares of splats in pixels are listed once. Values are blended front to back by them, as colours are
(``kernels.draw``), and the picture is gathered back to the splats by the same shares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.compiled import compiled
from glsplat.extras.authoring.optimize.kernels import _ALPHA_CAP, TILE, _alpha, _edges, _read, _span

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

VALUES = 6
"""Columns of a splat: normal 3, two other values, 1; all 0 for a splat that faces away."""
SUMS = 7
"""Columns of a splat: five blended values and 1, weighted by the squared cosine of the view; weighted pixels."""

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_MIN_FACING_SHARE = np.float32(0.5)  # of a pixel; with less, the surface is seen through


class Shares(NamedTuple):
    """Shares of pixels of E entries (splats in tiles, front to back); those of entry e begin at first[e]."""

    splat: I32  # [E]
    first: I64  # [E + 1]
    pixel: I32  # [K] row by row
    weight: F32  # [K] from 0 to 1


@compiled
def list_shares(
    tile_columns: int,
    start: I64,
    splat: I32,
    record: F32,
    box: I32,
    size: tuple[int, int],  # height, width
    min_transmittance: np.float32,  # a pixel is finished when less passes
    first: I64,  # [E + 1] written, as all below; see Shares
    pixel: I32,
    weight: F32,
) -> None:
    """Write the shares of pixels of the splats of a picture."""
    height, width = size
    passes = np.empty((TILE, TILE), np.float32)
    at = first[0] = 0
    for tile in range(len(start) - 1):
        left, top, right, bottom = _edges(tile, tile_columns, width, height)
        passes[:] = _ONE
        open_pixels = (right - left + 1) * (bottom - top + 1)  # pixels not yet opaque
        for entry in range(start[tile], start[tile + 1]):
            i = splat[entry]
            u, v, a, b, c, opacity, q, _, _, _ = _read(record, i)
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1 if open_pixels else 0):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y - top, x - left]
                    if before < min_transmittance:
                        continue
                    dx = np.float32(x) + _HALF - u
                    share = min(_alpha(opacity, a, b, c, dx, dy), _ALPHA_CAP) * before
                    passes[y - top, x - left] = before - share
                    open_pixels -= before - share < min_transmittance
                    pixel[at], weight[at] = y * width + x, share
                    at += 1
            first[entry + 1] = at


@compiled
def gather_visible(
    splat: I32,  # of Shares, as the next three
    first: I64,
    pixel: I32,
    weight: F32,
    pixels: int,
    values: F32,  # [N, VALUES]
    towards: F32,  # [3] unit, to the camera
    totals: F64,  # [N, SUMS] written
) -> None:
    """Blend ``values`` into a picture and gather it back to the splats by their shares."""
    blended = np.zeros((pixels, VALUES + 1), np.float32)
    for entry in range(len(splat)):
        i = splat[entry]
        n0, n1, n2, n3, n4, n5 = values[i, 0], values[i, 1], values[i, 2], values[i, 3], values[i, 4], values[i, 5]
        if n5 == _ZERO:
            continue
        for k in range(first[entry], first[entry + 1]):
            at, share = pixel[k], weight[k]
            blended[at, 0] += share * n0
            blended[at, 1] += share * n1
            blended[at, 2] += share * n2
            blended[at, 3] += share * n3
            blended[at, 4] += share * n4
            blended[at, 5] += share * n5
    _normalize(blended, towards)
    totals[:] = 0
    for entry in range(len(splat)):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = _ZERO
        for k in range(first[entry], first[entry + 1]):
            at, share = pixel[k], weight[k]
            s0 += share * blended[at, 0]
            s1 += share * blended[at, 1]
            s2 += share * blended[at, 2]
            s3 += share * blended[at, 3]
            s4 += share * blended[at, 4]
            s5 += share * blended[at, 5]
            s6 += share * blended[at, 6]
        total = totals[splat[entry]]
        total[0] += s0
        total[1] += s1
        total[2] += s2
        total[3] += s3
        total[4] += s4
        total[5] += s5
        total[6] += s6


@compiled
def _normalize(blended: F32, towards: F32) -> None:
    """Weight each pixel's mean by the squared cosine of the view, since rims show much of what lies behind."""
    for at in range(len(blended)):
        part = blended[at, 5]
        facing = part > _MIN_FACING_SHARE
        upright = _ZERO
        if facing:
            cosine = blended[at, 0] * towards[0] + blended[at, 1] * towards[1] + blended[at, 2] * towards[2]
            upright = min(max(cosine / part, _ZERO), _ONE) ** 2
        for k in range(5):
            blended[at, k] *= upright / max(part, _MIN_FACING_SHARE)
        blended[at, 5], blended[at, 6] = upright, _ONE if facing else _ZERO
