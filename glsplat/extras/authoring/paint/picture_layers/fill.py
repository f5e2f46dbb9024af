"""Continue a picture into holes: colours from around, and the grain of the nearest known place."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]

_FILL_HEIGHT_PX = 360.0  # of the person, where colours are filled
_REACH_FRACTIONS = (0.012, 0.025, 0.05, 0.1, 0.2)  # of the height; nearer colours first
_DOWN_TO_ACROSS = 0.12  # of the distances that colours are continued
_GRAIN_FRACTION = 0.012  # of the height: finer detail is grain
_GRAIN_RANGE = 0.7, 1.4


def disc(radius: int) -> NDArray[np.uint8]:
    """Return a round kernel [2 radius + 1, 2 radius + 1], ``radius`` in pixels, to dilate and erode masks."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)


def nearest_known(known: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return [H, W] row and column of the nearest ``known`` pixel; each pixel's own if none is known."""
    label, rows, columns, _ = nearest_known_labels(known)
    return rows[label], columns[label]


class NearestKnown(NamedTuple):
    """The nearest known pixel of each pixel of a picture."""

    label: NDArray[np.int32]  # [H, W]
    row: NDArray[np.intp]  # [N] of each label
    column: NDArray[np.intp]  # [N]
    distance: NDArray[np.float32]  # [H, W] pixels, within some percent


def nearest_known_labels(known: Mask) -> NearestKnown:
    """Return the nearest ``known`` pixel of each pixel [H, W]; its own if none is known."""
    if not known.any():
        row, column = np.indices(known.shape)
        label = np.arange(known.size, dtype=np.int32).reshape(known.shape)
        return NearestKnown(label, row.ravel(), column.ravel(), np.zeros(known.shape, np.float32))
    distance, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(known)
    source = np.zeros((2, int(label.max()) + 1), np.intp)
    source[:, label[rows, columns]] = rows, columns
    return NearestKnown(np.asarray(label, np.int32), source[0], source[1], np.asarray(distance, np.float32))


def fill_hole(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """Return ``picture`` [H, W, 3] with its ``hole`` filled from ``known`` pixels: across before down, as cloth is cut.

    ``height`` is the person's in pixels. The grain is mirrored at the edge of the nearest known place.
    """
    if not hole.any() or not known.any():
        return picture
    scale = min(1.0, _FILL_HEIGHT_PX / height)
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    weight = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    small = cv2.resize(picture * known[..., None].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total, weights = np.zeros_like(small), np.zeros(small.shape[:2], np.float32)
    for share in _REACH_FRACTIONS:
        reach = share * height * scale
        near = cv2.GaussianBlur(weight, (0, 0), reach, sigmaY=max(_DOWN_TO_ACROSS * reach, 1.0))
        mean = cv2.GaussianBlur(small, (0, 0), reach, sigmaY=max(_DOWN_TO_ACROSS * reach, 1.0))
        mean /= np.maximum(near, 1e-6)[..., None]
        more = np.minimum(near / 0.05, 1) * np.clip(1 - weights, 0, 1)
        total += more[..., None] * mean
        weights += more
    full = picture.shape[1::-1]
    smooth = cv2.resize(total / np.maximum(weights, 1e-6)[..., None], full, interpolation=cv2.INTER_LINEAR)
    found = hole & (cv2.resize(weights, full, interpolation=cv2.INTER_LINEAR) > 0.02)
    out = picture.copy()
    out[found] = np.clip(smooth[found] * _grain(picture, known, found, height), 0, 1)
    return out


def _grain(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """Return [K, 1] the relative brightness of the places mirrored at the edge of the known pixels."""
    label, row, column, _ = nearest_known_labels(known)
    nearest, (rows, columns) = label[hole], np.nonzero(hole)
    mirrored = 2 * row[nearest] - rows, 2 * column[nearest] - columns
    rows_in_all, width = known.shape
    inside = (mirrored[0] >= 0) & (mirrored[0] < rows_in_all) & (mirrored[1] >= 0) & (mirrored[1] < width)
    at = mirrored[0].clip(0, rows_in_all - 1), mirrored[1].clip(0, width - 1)
    some = np.flatnonzero(inside & known[at])
    at = at[0][some], at[1][some]
    weight = known.astype(np.float32)
    light = (picture[..., 0] + picture[..., 1] + picture[..., 2]) / 3
    reach = max(_GRAIN_FRACTION * height, 1.0)
    around = cv2.GaussianBlur(light * weight, (0, 0), reach) / np.maximum(cv2.GaussianBlur(weight, (0, 0), reach), 1e-4)
    grain = np.ones((len(rows), 1), np.float32)
    grain[some, 0] = np.clip((light[at] + 0.01) / (around[at] + 0.01), *_GRAIN_RANGE)
    return grain
