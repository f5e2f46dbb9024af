"""What splats' own values are against what a picture of these values shows where they lie: compiled loops.

Which splat makes how much of which pixel is found once; pictures of values are mixed by that front to back, as colours
are (``kernels.draw``), and what is seen at each pixel goes back to the splats by the same shares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.compiled import compiled
from glsplat.extras.authoring.geometry.footprints import ALPHA_MAX
from glsplat.extras.authoring.optimize.kernels import TILE, _alpha, _edges, _read, _span

__all__ = ["SUMS", "VALUES", "Shares", "agreed", "shared"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

VALUES = 6
"""Numbers a splat: its normal 3, two others, 1; all 0 of a splat that faces away."""
SUMS = 7
"""Numbers a splat: five values seen and 1, each by how upright the surface is seen; pixels that count."""

_ZERO, _ONE, _HALF = np.float32(0), np.float32(1), np.float32(0.5)
_CAP = np.float32(ALPHA_MAX)
_FACING = np.float32(0.5)  # of a pixel, at least, that shows what faces the camera: elsewhere one looks through


class Shares(NamedTuple):
    """How much of which pixel E entries make: splats in tiles, front to back; those of entry e from first[e] on."""

    splat: I32  # [E]
    first: I64  # [E + 1]
    pixel: I32  # [K] row by row
    weight: F32  # [K] from 0 to 1


@compiled
def shared(
    across: int,
    start: I64,
    splat: I32,
    record: F32,
    box: I32,
    size: tuple[int, int],  # height, width
    least: np.float32,  # of what passes: nothing counts where less passes
    first: I64,  # [E + 1] written, as all below; see Shares
    pixel: I32,
    weight: F32,
) -> None:
    """The shares of the splats of a picture."""
    height, width = size
    passes = np.empty((TILE, TILE), np.float32)
    at = first[0] = 0
    for tile in range(len(start) - 1):
        left, top, right, bottom = _edges(tile, across, width, height)
        passes[:] = _ONE
        clear = (right - left + 1) * (bottom - top + 1)  # pixels that something passes to
        for entry in range(start[tile], start[tile + 1]):
            i = splat[entry]
            u, v, a, b, c, opacity, q, _, _, _ = _read(record, i)
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1 if clear else 0):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y - top, x - left]
                    if before < least:
                        continue
                    dx = np.float32(x) + _HALF - u
                    share = min(_alpha(opacity, a, b, c, dx, dy), _CAP) * before
                    passes[y - top, x - left] = before - share
                    clear -= before - share < least
                    pixel[at], weight[at] = y * width + x, share
                    at += 1
            first[entry + 1] = at


@compiled
def agreed(
    splat: I32,  # of Shares, as the next three
    first: I64,
    pixel: I32,
    weight: F32,
    pixels: int,
    values: F32,  # [N, VALUES]
    towards: F32,  # [3] unit, to the camera
    totals: F64,  # [N, SUMS] written
) -> None:
    """What a picture of ``values`` shows, by the splats that it shows."""
    seen = np.zeros((pixels, VALUES + 1), np.float32)
    for entry in range(len(splat)):
        i = splat[entry]
        n0, n1, n2, n3, n4, n5 = values[i, 0], values[i, 1], values[i, 2], values[i, 3], values[i, 4], values[i, 5]
        if n5 == _ZERO:
            continue
        for k in range(first[entry], first[entry + 1]):
            at, share = pixel[k], weight[k]
            seen[at, 0] += share * n0
            seen[at, 1] += share * n1
            seen[at, 2] += share * n2
            seen[at, 3] += share * n3
            seen[at, 4] += share * n4
            seen[at, 5] += share * n5
    _weighed(seen, towards)
    totals[:] = 0
    for entry in range(len(splat)):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = _ZERO
        for k in range(first[entry], first[entry + 1]):
            at, share = pixel[k], weight[k]
            s0 += share * seen[at, 0]
            s1 += share * seen[at, 1]
            s2 += share * seen[at, 2]
            s3 += share * seen[at, 3]
            s4 += share * seen[at, 4]
            s5 += share * seen[at, 5]
            s6 += share * seen[at, 6]
        total = totals[splat[entry]]
        total[0] += s0
        total[1] += s1
        total[2] += s2
        total[3] += s3
        total[4] += s4
        total[5] += s5
        total[6] += s6


@compiled
def _weighed(seen: F32, towards: F32) -> None:
    """From sums over pixels to what is seen there, by how upright; rims show much of what is behind."""
    for at in range(len(seen)):
        part = seen[at, 5]
        good = part > _FACING
        upright = _ZERO
        if good:
            cosine = seen[at, 0] * towards[0] + seen[at, 1] * towards[1] + seen[at, 2] * towards[2]
            upright = min(max(cosine / part, _ZERO), _ONE) ** 2
        for k in range(5):
            seen[at, k] *= upright / max(part, _FACING)
        seen[at, 5], seen[at, 6] = upright, _ONE if good else _ZERO
