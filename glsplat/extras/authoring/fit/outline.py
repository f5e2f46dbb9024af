"""Find the outline of the projected body, and its distances to the edge of the picture's mask."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.geometry.raster import box_pixels, pixel_span
from glsplat.meshes import vertex_normals
from glsplat.rotations import component_sums, lengths, unit_vectors

_MAX_BRIM_HEIGHT_FRACTION, _MIN_BRIM_WIDTH_FRACTION = 0.045, 0.02  # of the person's height; hair is higher


def projected_mask(pixels: F64, faces: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return the mask [H, W] of pixels whose centres lie in a triangle that faces the camera; ``pixels`` [V, 2]."""
    height, width = shape
    turned = faces[:, [0, 2, 1]]  # counter-clockwise with y up is clockwise with y down
    x, y = ([pixels[corner, axis] for corner in turned.T] for axis in (0, 1))
    front = np.flatnonzero((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]) > 0)
    x, y = ([corner[front] for corner in axis] for axis in (x, y))
    (left, wide), (top, high) = pixel_span(x[0], x[1], x[2], width), pixel_span(y[0], y[1], y[2], height)
    face, column, row = box_pixels(left, top, wide, high)
    hit = np.ones(len(face), bool)
    for k in range(3):
        n = (k + 1) % 3
        edge_x, edge_y = x[n] - x[k], y[n] - y[k]
        level = edge_x * y[k] - edge_y * x[k]
        hit &= edge_x[face] * (row + 0.5) - edge_y[face] * (column + 0.5) >= level[face]
    mask = np.zeros(height * width, bool)
    mask[row[hit] * width + column[hit]] = True
    return mask.reshape(shape)


def overlap(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    """Return the intersection over union of two masks of equal shape; 1 if both are empty."""
    union = int((first | second).sum())
    return int((first & second).sum()) / union if union else 1.0


@dataclass(frozen=True, eq=False)
class Rim:
    """The K vertices on the outline of the projected body."""

    vertices: NDArray[np.intp]  # [K]
    pixels: F64  # [K, 2]
    normals: F64  # [K, 2] unit vectors, outwards in the picture
    gaps: F64  # [K] pixels along the normal to the mask's edge, negative inside the body; NaN: no edge in reach


def find_rim(
    body: Body, where: F64, pixels: F64, mask: NDArray[np.bool_], reach: float, flat: float
) -> tuple[Rim, NDArray[np.bool_]]:
    """Return the rim of a posed body [V, 3] in camera axes with ``pixels`` [V, 2], and its projected mask [H, W].

    A vertex is on the rim if its normal is perpendicular to the line of sight (cosine below ``flat``) and the
    projected mask ends beside it. Edges of ``mask`` are searched within ``reach`` pixels on both sides.
    """
    height, width = mask.shape
    drawn = projected_mask(pixels, body.faces, mask.shape)
    inside = cv2.distanceTransform(drawn.astype(np.uint8), cv2.DIST_L2, 3)
    normals = vertex_normals(where, body.faces)
    facing = np.abs(component_sums(normals * where)) / lengths(where)
    nearest = np.floor(pixels).astype(np.intp)
    shown = ((nearest >= 0) & (nearest < (width, height))).all(axis=1)
    column, row = nearest[:, 0].clip(0, width - 1), nearest[:, 1].clip(0, height - 1)
    chosen = np.flatnonzero(body.skin & shown & (facing < flat) & (inside[row, column] < 2.2))
    across = unit_vectors(normals[chosen, :2], 1e-9)
    return Rim(chosen, pixels[chosen], across, edge_distances(mask, pixels[chosen], across, reach)), drawn


def edge_distances(mask: NDArray[np.bool_], start: F64, along: F64, reach: float) -> F64:
    """Return signed distances [K] in pixels from ``start`` [K, 2] along ``along`` [K, 2] to the mask's nearest edge."""
    steps = np.arange(-reach, reach + 0.5, 0.5)
    inside = _sampled(mask, start, along, steps)
    ends = inside[:, :-1] & ~inside[:, 1:]
    middle = (steps[:-1] + steps[1:]) / 2
    far = np.where(ends, np.abs(middle), np.inf)
    best = far.argmin(axis=1)
    return np.where(np.isfinite(far.min(axis=1)), middle[best], np.nan)


def brimless(mask: NDArray[np.bool_], figure: float) -> NDArray[np.bool_]:
    """Return the ``mask`` without flat parts that stand out, as brims of hats; ``figure`` is its height in pixels."""
    high = max(3, round(_MAX_BRIM_HEIGHT_FRACTION * figure))
    whole = mask.astype(np.uint8)
    flat = whole - cv2.morphologyEx(whole, cv2.MORPH_OPEN, np.ones((high, 1), np.uint8))
    _, pieces, sizes, _ = cv2.connectedComponentsWithStats(flat)
    wide = np.flatnonzero(sizes[:, cv2.CC_STAT_WIDTH] > _MIN_BRIM_WIDTH_FRACTION * figure)
    return np.asarray(mask & ~np.isin(pieces, wide[wide > 0]))


def half_gaps(mask: NDArray[np.bool_], drawn: NDArray[np.bool_], start: F64, along: F64, reach: float) -> F64:
    """Return half the distance [K] in pixels across gaps between two parts of the body that the mask fills.

    ``drawn`` [H, W] is the body's mask. Both parts then meet in the middle, as for a skirt between legs or a sleeve in
    an armpit. NaN if there is no such gap within twice ``reach`` pixels.
    """
    steps = np.arange(2.0, 2 * reach, 0.5)  # the first pixels lie on the outline itself
    looked = np.floor(start[:, None] + along[:, None] * steps[:, None]).astype(np.intp)
    height, width = mask.shape
    column, row = looked[..., 0].clip(0, width - 1), looked[..., 1].clip(0, height - 1)
    covered = drawn[row, column]
    far = covered.argmax(axis=1)
    bare = np.arange(len(steps)) < far[:, None]
    bridged = covered.any(axis=1) & ~covered[:, 0] & (mask[row, column] | ~bare).all(axis=1)
    return np.where(bridged, steps[far] / 2 + 0.5, np.nan)


def lengths_inside(mask: NDArray[np.bool_], start: F64, along: F64, reach: float) -> F64:
    """Return the distances [K] in pixels from ``start`` [K, 2] along ``along`` [K, 2] that stay in the ``mask``.

    NaN if shorter than about a pixel or longer than ``reach``.
    """
    steps = np.arange(0.0, reach + 0.5, 0.5)
    outside = ~_sampled(mask, start, along, steps)
    first = outside.argmax(axis=1)
    return np.where(outside.any(axis=1) & (first > 2), steps[first] - 0.25, np.nan)


def _sampled(mask: NDArray[np.bool_], start: F64, along: F64, steps: F64) -> NDArray[np.bool_]:
    """Return the mask's values [K, S] at ``steps`` [S] from ``start`` [K, 2]; false outside the picture."""
    places = np.floor(start[:, None] + along[:, None] * steps[:, None]).astype(np.intp)
    height, width = mask.shape
    beyond = ((places < 0) | (places >= (width, height))).any(axis=2)
    return np.asarray(mask[places[..., 1].clip(0, height - 1), places[..., 0].clip(0, width - 1)] & ~beyond)
