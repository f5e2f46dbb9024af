"""The outline of the projected body, and how far the picture's mask reaches beyond it or falls short of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.geometry.raster import box_pixels, pixel_span
from glsplat.meshes import vertex_normals
from glsplat.rotations import component_sums, lengths, unit_vectors

__all__ = ["Rim", "brimless", "edge_distances", "find_rim", "half_gaps", "lengths_inside", "overlap", "projected_mask"]

F64 = NDArray[np.float64]

_BRIM = 0.045, 0.02  # of the figure: what is less high and wider beside a head is no hair


def projected_mask(pixels: F64, faces: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """[H, W] pixels whose centres lie in a triangle that turns to the camera; ``pixels`` [V, 2], centres at +0.5."""
    height, width = shape
    seen = faces[:, [0, 2, 1]]  # counter-clockwise with y up is clockwise with y down
    x, y = ([pixels[corner, axis] for corner in seen.T] for axis in (0, 1))
    some = np.flatnonzero((x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]) > 0)
    x, y = ([corner[some] for corner in axis] for axis in (x, y))
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
    """Intersection over union of two masks of one shape; 1 for two empty ones."""
    union = int((first | second).sum())
    return int((first & second).sum()) / union if union else 1.0


@dataclass(frozen=True, eq=False)
class Rim:
    """The K vertices on the outline of the projected body."""

    vertices: NDArray[np.intp]  # [K]
    pixels: F64  # [K, 2]
    normals: F64  # [K, 2] unit, outwards in the picture
    gaps: F64  # [K] pixels along the normal to the mask's edge, below zero inside the body; NaN: no edge in reach


def find_rim(
    body: Body, where: F64, pixels: F64, mask: NDArray[np.bool_], reach: float, flat: float
) -> tuple[Rim, NDArray[np.bool_]]:
    """The rim of a posed body [V, 3] in camera axes that lies at ``pixels`` [V, 2], and its projected mask [H, W].

    A vertex is on the rim where its normal is square to the line of sight (cosine below ``flat``) and the projected
    mask ends beside it; edges are looked for ``reach`` pixels to both sides.
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
    """[K] pixels from ``start`` [K, 2] along unit ``along`` [K, 2] to the nearest place where the mask ends."""
    steps = np.arange(-reach, reach + 0.5, 0.5)
    looked = np.floor(start[:, None] + along[:, None] * steps[:, None]).astype(np.intp)
    height, width = mask.shape
    beyond = ((looked < 0) | (looked >= (width, height))).any(axis=2)
    inside = mask[looked[..., 1].clip(0, height - 1), looked[..., 0].clip(0, width - 1)] & ~beyond
    ends = inside[:, :-1] & ~inside[:, 1:]
    middle = (steps[:-1] + steps[1:]) / 2
    far = np.where(ends, np.abs(middle), np.inf)
    best = far.argmin(axis=1)
    return np.where(np.isfinite(far.min(axis=1)), middle[best], np.nan)


def brimless(mask: NDArray[np.bool_], figure: float) -> NDArray[np.bool_]:
    """The ``mask`` without what stands far out of it and is flat, as brims of hats are; ``figure`` is its height."""
    high = max(3, round(_BRIM[0] * figure))
    whole = mask.astype(np.uint8)
    flat = whole - cv2.morphologyEx(whole, cv2.MORPH_OPEN, np.ones((high, 1), np.uint8))
    _, pieces, sizes, _ = cv2.connectedComponentsWithStats(flat)
    wide = np.flatnonzero(sizes[:, cv2.CC_STAT_WIDTH] > _BRIM[1] * figure)
    return np.asarray(mask & ~np.isin(pieces, wide[wide > 0]))


def half_gaps(mask: NDArray[np.bool_], drawn: NDArray[np.bool_], start: F64, along: F64, reach: float) -> F64:
    """[K] half the way from ``start`` along ``along`` through mask that no body covers to the next part of the body.

    So a skirt between two legs and a sleeve in an armpit are met from both sides. NaN where there is no such gap within
    twice ``reach`` pixels.
    """
    steps = np.arange(2.0, 2 * reach, 0.5)  # the first steps are still on the outline itself
    looked = np.floor(start[:, None] + along[:, None] * steps[:, None]).astype(np.intp)
    height, width = mask.shape
    column, row = looked[..., 0].clip(0, width - 1), looked[..., 1].clip(0, height - 1)
    covered = drawn[row, column]
    far = covered.argmax(axis=1)
    bare = np.arange(len(steps)) < far[:, None]
    bridged = covered.any(axis=1) & ~covered[:, 0] & (mask[row, column] | ~bare).all(axis=1)
    return np.where(bridged, steps[far] / 2 + 0.5, np.nan)


def lengths_inside(mask: NDArray[np.bool_], start: F64, along: F64, reach: float) -> F64:
    """[K] pixels from ``start`` [K, 2] along unit ``along`` [K, 2] that lie in the ``mask`` [H, W] without a break.

    NaN where these are hardly one, or more than ``reach``.
    """
    steps = np.arange(0.0, reach + 0.5, 0.5)
    looked = np.floor(start[:, None] + along[:, None] * steps[:, None]).astype(np.intp)
    height, width = mask.shape
    beyond = ((looked < 0) | (looked >= (width, height))).any(axis=2)
    outside = beyond | ~mask[looked[..., 1].clip(0, height - 1), looked[..., 0].clip(0, width - 1)]
    first = outside.argmax(axis=1)
    return np.where(outside.any(axis=1) & (first > 2), steps[first] - 0.25, np.nan)
