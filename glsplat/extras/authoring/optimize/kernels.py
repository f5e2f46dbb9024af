"""The pixel contract and its derivatives as compiled loops: projection, tiles, drawing, backward pass.

The same computation as footprints.py (tests compare them), in single precision per pixel and double precision per
splat. A picture is cut into square tiles; an *entry* is a splat in a tile, and a tile's entries are sorted near to
far. Each function works on a part of the splats or of the tiles, so that threads can share the work.

Formulas: EWA projection and front-to-back compositing of 3D Gaussian Splatting (Kerbl et al. 2023), differentiated by
hand. The projection's Jacobian counts as constant under a moving mean.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.compute.compiled import compiled
from glsplat.extras.authoring.geometry.footprints import ALPHA_MAX, ALPHA_MIN, EPS2D, MAX_SIGMA
from glsplat.reference import AA_FLOOR

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
I64 = NDArray[np.int64]

TILE = 64
"""Pixels a side."""
RECORD = 11
"""Columns of a projected splat: u, v, conic a b c, opacity, squared extent, depth, colour 3."""
SUMS = 11
"""Columns of an entry of ``backward``: offset 2, its squares 3, exponent, colour 3, weight, error."""
GRADIENTS = 15
"""Columns of a splat of ``gather``: mean 3, logarithm of the scales 3, turn 3, exponent, colour 3, weight, error."""

_ONE, _HALF, _TWO = np.float32(1), np.float32(0.5), np.float32(2)
_ALPHA_CAP = np.float32(ALPHA_MAX)
_CLAMP_MARGIN = 0.15  # fraction of the picture beyond its edge, from where the Jacobian is constant


@compiled
def _exp(x: np.float32) -> np.float32:
    """Return exp(x) for -8 < x <= 0 in single precision: the series of exp(x / 8), to the eighth power."""
    y = x * np.float32(0.125)
    p = np.float32(1 / 120) + y * np.float32(1 / 720)
    p = _ONE + y * (_ONE + y * (_HALF + y * (np.float32(1 / 6) + y * (np.float32(1 / 24) + y * p))))
    p = p * p
    p = p * p
    return p * p


@compiled
def project(
    first: int,
    last: int,
    splats: tuple[F64, F64, F64, F64, F64],  # means [N, 3], rotations [N, 3, 3], scales, opacities, colours
    view: F64,
    intrinsics: tuple[float, float, float, float],  # fx, fy, cx, cy
    size: tuple[int, int],
    near: float,
    antialias: bool,
    record: F32,  # [N, RECORD]; an opacity of 0: not in the picture
    box: I32,  # [N, 4] columns and rows, first and last
    to_pixels: F64,  # [N, 2, 3]
    axes: F64,  # [N, 2, 3] of the splat, on the screen
    slope: F64,  # [N, 3] of the logarithm of the compensation by the covariance: xx, xy, yy
) -> None:
    """Project the splats first to last, as in footprints()."""
    means, rotations, scales, opacities, colours = splats
    fx, fy, cx, cy = intrinsics
    width, height = size
    left, right = -cx / fx - _CLAMP_MARGIN * width / fx, (width - cx) / fx + _CLAMP_MARGIN * width / fx
    top, bottom = -cy / fy - _CLAMP_MARGIN * height / fy, (height - cy) / fy + _CLAMP_MARGIN * height / fy
    for i in range(first, last):
        x, y, z = view[0, 3], view[1, 3], view[2, 3]
        for k in range(3):
            x += view[0, k] * means[i, k]
            y += view[1, k] * means[i, k]
            z += view[2, k] * means[i, k]
        record[i, 5], record[i, 7] = 0, z
        if not z > near:
            continue
        tx, ty = min(max(x / z, left), right), min(max(y / z, top), bottom)
        for k in range(3):
            to_pixels[i, 0, k] = fx / z * (view[0, k] - tx * view[2, k])
            to_pixels[i, 1, k] = fy / z * (view[1, k] - ty * view[2, k])
        a = b = c = 0.0
        for k in range(3):
            p = q = 0.0
            for m in range(3):
                p += to_pixels[i, 0, m] * rotations[i, m, k]
                q += to_pixels[i, 1, m] * rotations[i, m, k]
            axes[i, 0, k], axes[i, 1, k] = p, q
            power = scales[i, k] * scales[i, k]
            a += p * p * power
            b += p * q * power
            c += q * q * power
        sharp = 0.0  # the determinant by Lagrange, where a c - b^2 would cancel
        for k in range(3):
            m = (k + 1) % 3
            minor = (axes[i, 0, k] * axes[i, 1, m] - axes[i, 0, m] * axes[i, 1, k]) * scales[i, k] * scales[i, m]
            sharp += minor * minor
        det = sharp + EPS2D * (a + c) + EPS2D * EPS2D
        wide, high = a + EPS2D, c + EPS2D
        opacity = opacities[i]
        slope[i, 0] = slope[i, 1] = slope[i, 2] = 0.0
        if antialias:
            kept = sharp / det
            if kept > AA_FLOOR:
                slope[i, 0] = 0.5 * (c / sharp - high / det)
                slope[i, 1] = 0.5 * (b / det - b / sharp)
                slope[i, 2] = 0.5 * (a / sharp - wide / det)
            opacity *= math.sqrt(max(kept, AA_FLOOR))
        if not opacity >= ALPHA_MIN:
            continue
        u, v = fx * x / z + cx, fy * y / z + cy
        extent = min(MAX_SIGMA, math.sqrt(2 * math.log(opacity / ALPHA_MIN)))
        reach_x, reach_y = extent * math.sqrt(wide), extent * math.sqrt(high)
        x0, x1 = max(u - reach_x - 0.5, 0.0), min(u + reach_x - 0.5, width - 1.0)
        y0, y1 = max(v - reach_y - 0.5, 0.0), min(v + reach_y - 0.5, height - 1.0)
        if not (x0 <= x1 and y0 <= y1):
            continue
        box[i, 0], box[i, 1] = math.ceil(x0), math.floor(x1)
        box[i, 2], box[i, 3] = math.ceil(y0), math.floor(y1)
        if box[i, 0] > box[i, 1] or box[i, 2] > box[i, 3]:
            continue
        record[i, 0], record[i, 1] = u, v
        record[i, 2], record[i, 3], record[i, 4] = high / det, -b / det, wide / det
        record[i, 5], record[i, 6] = opacity, extent * extent
        record[i, 8], record[i, 9], record[i, 10] = colours[i, 0], colours[i, 1], colours[i, 2]


@compiled
def list_entries(order: I64, box: I32, tile_columns: int, tile_rows: int) -> tuple[I64, I32]:
    """Return where the entries of each tile begin [tiles + 1], and the splat of each entry.

    ``order`` [K]: the splats in the picture, near to far.
    """
    start = np.zeros(tile_columns * tile_rows + 1, np.int64)
    for i in order:
        for row in range(box[i, 2] // TILE, box[i, 3] // TILE + 1):
            for column in range(box[i, 0] // TILE, box[i, 1] // TILE + 1):
                start[row * tile_columns + column + 1] += 1
    for tile in range(tile_columns * tile_rows):
        start[tile + 1] += start[tile]
    splat = np.empty(start[-1], np.int32)
    at = start[:-1].copy()
    for i in order:
        for row in range(box[i, 2] // TILE, box[i, 3] // TILE + 1):
            for column in range(box[i, 0] // TILE, box[i, 1] // TILE + 1):
                tile = row * tile_columns + column
                splat[at[tile]] = i
                at[tile] += 1
    return start, splat


@compiled
def _span(
    a: np.float32, b: np.float32, c: np.float32, q: np.float32, dy: np.float32, u: np.float32, low: int, high: int
) -> tuple[int, int]:
    """Return the first and last column of a row in which a dx^2 + 2 b dx dy + c dy^2 <= q."""
    under = b * b * dy * dy - a * (c * dy * dy - q)
    if under <= np.float32(0):
        return 1, 0
    root, middle = math.sqrt(under), -b * dy
    return (
        max(math.ceil((middle - root) / a + u - _HALF), low),
        min(math.floor((middle + root) / a + u - _HALF), high),
    )


@compiled
def _edges(tile: int, tile_columns: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Return the first column and row of a tile, and the last."""
    left, top = (tile % tile_columns) * TILE, (tile // tile_columns) * TILE
    return left, top, min(left + TILE, width) - 1, min(top + TILE, height) - 1


@compiled
def _read(record: F32, i: int) -> tuple[np.float32, ...]:
    """Return u, v, conic a b c, opacity, squared extent and colour of a splat."""
    r = record[i]
    return r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[8], r[9], r[10]


@compiled
def _alpha(
    opacity: np.float32, a: np.float32, b: np.float32, c: np.float32, dx: np.float32, dy: np.float32
) -> np.float32:
    """Return the alpha, before the cap, at (dx, dy) pixels from the centre of a splat."""
    return opacity * _exp(-_HALF * (a * dx * dx + _TWO * b * dx * dy + c * dy * dy))


@compiled
def draw(
    tiles: I64,
    tile_columns: int,
    start: I64,
    splat: I32,
    record: F32,
    box: I32,
    picture: F32,  # [H, W, 4] premultiplied, added to
    passes: F32,  # [H, W] transmittance, initially 1
    least: np.float32,  # of it: nothing is drawn where less passes
) -> None:
    """Draw ``tiles`` of the picture."""
    height, width = passes.shape
    for tile in tiles:
        left, top, right, bottom = _edges(tile, tile_columns, width, height)
        open_pixels = (right - left + 1) * (bottom - top + 1)  # pixels not yet opaque
        for entry in range(start[tile], start[tile + 1]):
            if not open_pixels:
                break
            i = splat[entry]
            u, v, a, b, c, opacity, q, red, green, blue = _read(record, i)
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y, x]
                    if before < least:
                        continue
                    dx = np.float32(x) + _HALF - u
                    alpha = min(_alpha(opacity, a, b, c, dx, dy), _ALPHA_CAP)
                    weight = alpha * before
                    picture[y, x, 0] += weight * red
                    picture[y, x, 1] += weight * green
                    picture[y, x, 2] += weight * blue
                    picture[y, x, 3] += weight
                    passes[y, x] = before - weight
                    open_pixels -= before - weight < least


@compiled
def backward(
    tiles: I64,
    tile_columns: int,
    start: I64,
    splat: I32,
    record: F32,
    box: I32,
    slope: F32,  # [H, W, 4] of the loss by the picture
    error: F32,  # [H, W]
    passes: F32,  # [H, W] initially 1
    least: np.float32,  # as of draw()
    behind: F32,  # [H, W] initially the sum over channels of slope times picture
    sums: F32,  # [E, SUMS] written
) -> None:
    """Write the gradient of the loss for each splat-tile pair in ``tiles``."""
    height, width = passes.shape
    zero = np.float32(0)
    for tile in tiles:
        left, top, right, bottom = _edges(tile, tile_columns, width, height)
        open_pixels = (right - left + 1) * (bottom - top + 1)
        for entry in range(start[tile], start[tile + 1]):
            if not open_pixels:
                sums[entry] = zero
                continue
            i = splat[entry]
            u, v, a, b, c, opacity, q, red, green, blue = _read(record, i)
            sx = sy = sxx = sxy = syy = total = by_red = by_green = by_blue = seen = wrong = zero
            for y in range(max(box[i, 2], top), min(box[i, 3], bottom) + 1):
                dy = np.float32(y) + _HALF - v
                x0, x1 = _span(a, b, c, q, dy, u, left, right)
                for x in range(x0, x1 + 1):
                    before = passes[y, x]
                    if before < least:
                        continue
                    dx = np.float32(x) + _HALF - u
                    raw = _alpha(opacity, a, b, c, dx, dy)
                    alpha = min(raw, _ALPHA_CAP)
                    weight = alpha * before
                    by_weight = slope[y, x, 0] * red + slope[y, x, 1] * green + slope[y, x, 2] * blue + slope[y, x, 3]
                    rest = behind[y, x] - weight * by_weight
                    behind[y, x] = rest
                    passes[y, x] = before - weight
                    open_pixels -= before - weight < least
                    by_red += weight * slope[y, x, 0]
                    by_green += weight * slope[y, x, 1]
                    by_blue += weight * slope[y, x, 2]
                    seen += weight
                    wrong += weight * error[y, x]
                    if raw < _ALPHA_CAP:
                        by_exponent = (before * by_weight - rest / (_ONE - alpha)) * alpha
                        total += by_exponent
                        sx += by_exponent * dx
                        sy += by_exponent * dy
                        sxx += by_exponent * dx * dx
                        sxy += by_exponent * dx * dy
                        syy += by_exponent * dy * dy
            sums[entry, 0], sums[entry, 1] = sx, sy
            sums[entry, 2], sums[entry, 3], sums[entry, 4] = sxx, sxy, syy
            sums[entry, 5] = total
            sums[entry, 6], sums[entry, 7], sums[entry, 8] = by_red, by_green, by_blue
            sums[entry, 9], sums[entry, 10] = seen, wrong


@compiled
def add_up(splat: I32, sums: F32, totals: F64) -> None:
    """Sum entries [E, K] to splats [N, K], always in the same order."""
    totals[:] = 0
    for entry in range(len(splat)):
        i = splat[entry]
        for k in range(sums.shape[1]):
            totals[i, k] += sums[entry, k]


@compiled
def gather(
    first: int,
    last: int,
    totals: F64,
    record: F32,
    to_pixels: F64,
    axes: F64,
    slope: F64,
    scales: F64,
    out: F64,  # [N, GRADIENTS]
) -> None:
    """Write the derivatives by the parameters of splats first to last, from sums over pixels."""
    mixed = np.empty((3, 3))
    for i in range(first, last):
        out[i] = 0
        if not (record[i, 5] > 0 and totals[i, 9] > 0):
            continue
        a, b, c = float(record[i, 2]), float(record[i, 3]), float(record[i, 4])
        s = totals[i]
        by_u, by_v = a * s[0] + b * s[1], b * s[0] + c * s[1]
        # half the conic times the sum of squared offsets times the conic
        p, q = a * s[2] + b * s[3], a * s[3] + b * s[4]
        m, n = b * s[2] + c * s[3], b * s[3] + c * s[4]
        xx = 0.5 * (p * a + q * b) + s[5] * slope[i, 0]
        xy = 0.5 * (p * b + q * c) + s[5] * slope[i, 1]
        yy = 0.5 * (m * b + n * c) + s[5] * slope[i, 2]
        for k in range(3):
            out[i, k] = to_pixels[i, 0, k] * by_u + to_pixels[i, 1, k] * by_v
            px, py = xx * axes[i, 0, k] + xy * axes[i, 1, k], xy * axes[i, 0, k] + yy * axes[i, 1, k]
            for j in range(3):
                mixed[j, k] = 2 * (axes[i, 0, j] * px + axes[i, 1, j] * py)
        s0, s1, s2 = scales[i, 0] ** 2, scales[i, 1] ** 2, scales[i, 2] ** 2
        out[i, 3], out[i, 4], out[i, 5] = s0 * mixed[0, 0], s1 * mixed[1, 1], s2 * mixed[2, 2]
        out[i, 6] = mixed[2, 1] * s1 - mixed[1, 2] * s2
        out[i, 7] = mixed[0, 2] * s2 - mixed[2, 0] * s0
        out[i, 8] = mixed[1, 0] * s0 - mixed[0, 1] * s1
        for k in range(6):
            out[i, 9 + k] = s[5 + k]
