"""A picture continued where it shows something else: colours from around, and the grain of what is nearest."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["continued", "disc", "nearest_known", "only_in_the_middle", "sources"]

Mask = NDArray[np.bool_]
Picture = NDArray[np.float32]

_SMALL = 360.0  # pixels of the person's height that colours are continued at
_REACHES = (0.012, 0.025, 0.05, 0.1, 0.2)  # of the height, the nearer the sooner
_FLAT = 0.12  # how far cloth is continued down against across
_SIDES = 0.7, 0.95  # halves of a trunk's width between which it is taken to look all around as it does there
_ALIKE, _LEVEL = (22.0, 8.0, 8.0), 0.06  # of Lab, and metres of height: colours nearer than that are the same
_FEWEST = 50  # pixels
_SEVERAL = 6  # pixels of the sides that a colour has to be found at
_GRAIN = 0.012  # of the height: what is finer is grain


def disc(radius: int) -> NDArray[np.uint8]:
    """[2 radius + 1, 2 radius + 1] a round kernel of so many pixels, to grow and shrink masks by."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)


def nearest_known(known: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """[H, W] row and column of the nearest ``known`` pixel; every pixel's own where none is known."""
    label, rows, columns = sources(known)
    return rows[label], columns[label]


def sources(known: Mask) -> tuple[NDArray[np.int32], NDArray[np.intp], NDArray[np.intp]]:
    """[H, W] the number of the nearest ``known`` pixel, and [N] row and column of each number; as ``nearest_known``."""
    if not known.any():
        row, column = np.indices(known.shape)
        return np.arange(known.size, dtype=np.int32).reshape(known.shape), row.ravel(), column.ravel()
    _, label = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(known)
    source = np.zeros((2, int(label.max()) + 1), np.intp)
    source[:, label[rows, columns]] = rows, columns
    return np.asarray(label, np.int32), source[0], source[1]


def only_in_the_middle(picture: Picture, place: NDArray[np.float64], known: Mask) -> Mask:
    """[H, W] where a trunk has colours that one of its sides has not at a height nearby: prints, ties, openings.

    ``place`` [H, W, 2] says how far each pixel lies to the side, in halves of the width, and how high, in metres; NaN
    beside the trunk. ``picture`` is linear; sides are looked at where they are ``known``.
    """
    aside = place[..., 0]
    between = np.abs(aside) < _SIDES[1]
    lab = cv2.cvtColor(np.sqrt(picture.clip(0, 1)), cv2.COLOR_RGB2LAB)
    features = np.concatenate([lab / np.array(_ALIKE), place[..., 1:] / _LEVEL], axis=2)
    away = np.zeros(int(between.sum()))
    for sign in (-1.0, 1.0):
        at_side = known & (sign * aside > _SIDES[0]) & (sign * aside < _SIDES[1])
        if at_side.sum() < _FEWEST:
            continue
        height, levels = features[between][:, 3], np.sort(features[at_side][:, 3])
        many = np.searchsorted(levels, height + 0.5) - np.searchsorted(levels, height - 0.5)
        unlike = cKDTree(features[at_side]).query(features[between], _SEVERAL)[0][:, -1]
        away = np.maximum(away, np.where(many > 2 * _SEVERAL, unlike, 0))
    found = np.zeros(known.shape, np.uint8)
    found[between] = away > 1
    kernel = np.ones((3, 3), np.uint8)
    found = cv2.dilate(cv2.morphologyEx(found, cv2.MORPH_OPEN, kernel), kernel, iterations=2)
    return np.asarray((found > 0) & np.isfinite(aside))


def continued(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """``picture`` [H, W, 3] with its ``hole`` filled from what is ``known``: across rather than down, as cloth is cut.

    ``height`` is the person's in pixels. The grain is that of the nearest known place, mirrored at its edge.
    """
    if not hole.any() or not known.any():
        return picture
    scale = min(1.0, _SMALL / height)
    size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
    weight = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    small = cv2.resize(picture * known[..., None].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total, sure = np.zeros_like(small), np.zeros(small.shape[:2], np.float32)
    for share in _REACHES:
        reach = share * height * scale
        near = cv2.GaussianBlur(weight, (0, 0), reach, sigmaY=max(_FLAT * reach, 1.0))
        mean = cv2.GaussianBlur(small, (0, 0), reach, sigmaY=max(_FLAT * reach, 1.0))
        mean /= np.maximum(near, 1e-6)[..., None]
        more = np.minimum(near / 0.05, 1) * np.clip(1 - sure, 0, 1)
        total += more[..., None] * mean
        sure += more
    full = picture.shape[1::-1]
    smooth = cv2.resize(total / np.maximum(sure, 1e-6)[..., None], full, interpolation=cv2.INTER_LINEAR)
    found = hole & (cv2.resize(sure, full, interpolation=cv2.INTER_LINEAR) > 0.02)
    out = picture.copy()
    out[found] = np.clip(smooth[found] * _grain(picture, known, found, height), 0, 1)
    return out


def _grain(picture: Picture, known: Mask, hole: Mask, height: float) -> Picture:
    """[K, 1] brightness against its surroundings of the places mirrored at the edge of what is known."""
    label, row, column = sources(known)
    nearest, (rows, columns) = label[hole], np.nonzero(hole)
    mirrored = 2 * row[nearest] - rows, 2 * column[nearest] - columns
    height_, width = known.shape
    inside = (mirrored[0] >= 0) & (mirrored[0] < height_) & (mirrored[1] >= 0) & (mirrored[1] < width)
    at = mirrored[0].clip(0, height_ - 1), mirrored[1].clip(0, width - 1)
    some = np.flatnonzero(inside & known[at])
    at = at[0][some], at[1][some]
    weight = known.astype(np.float32)
    light = (picture[..., 0] + picture[..., 1] + picture[..., 2]) / 3
    reach = max(_GRAIN * height, 1.0)
    around = cv2.GaussianBlur(light * weight, (0, 0), reach) / np.maximum(cv2.GaussianBlur(weight, (0, 0), reach), 1e-4)
    grain = np.ones((len(rows), 1), np.float32)
    grain[some, 0] = np.clip((light[at] + 0.01) / (around[at] + 0.01), 0.7, 1.4)
    return grain
