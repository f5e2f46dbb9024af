"""Refine a network's coarse mask of the person to the picture's resolution. Equal inputs give equal bytes.

The network's outline is off by some pixels. In a band around it, each pixel's colour is compared with the colours of
the person and of the room nearby; the log odds are smoothed along the picture's edges. On the floor, darker shades of
the room's colours count as room, because they are the person's shadow.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.errors import FormatError
from glsplat.extras.authoring.networks.head_parts import HeadPart
from glsplat.extras.authoring.networks.person import DetectedBody, bounds
from glsplat.extras.authoring.photo.photo_file import Photo, read_photo

MaskSource = str | os.PathLike[str] | NDArray[np.bool_]
"""A picture file, or a mask [H, W] of the pixels of ``Photo.picture``."""
_MIN_FRACTION, _MAX_FRACTION = 0.002, 0.95  # of the picture that a person covers
_MIN_LOCK_FRACTION = 0.1  # width of a lock that a mask lacks, of the root of the hair's area
# Of each round: half width of the band and half width of the window of compared colours, both fractions of the height
# of the network's mask, and the factor by which the picture is reduced.
_ROUNDS = ((0.015, 0.03, 2), (0.008, 0.02, 1))
_MIN_THICKNESS_FRACTION = 0.004  # of the height; the middle lines of thinner parts are not the person's; fingers are
_NOISE_LEVELS = 5.0  # standard deviation of colours, in 8-bit levels
_NETWORK_WEIGHT, _COLOUR_WEIGHT = 0.8, 0.5  # of log odds
_MAX_LOG_ODDS = 6.0  # of one pixel's colour, before they are weighted
_SMOOTHNESS, _EDGE_LEVELS = 30.0, 15.0  # lambda and sigma of OpenCV's fast global smoother; sigma in 8-bit levels
_SHADOW_LOG_ODDS = 2.0  # penalty of a completely dark shadow
_FLOOR_FRACTION = 0.05  # of the height, above the ankles: shadows on the floor are expected below
_SHADOW_FACTORS = (0.88, 0.76, 0.64, 0.52, 0.4)  # brightness of shadows, in sRGB values
_SURE_COUNT_PX = np.float32(30)  # pixels from which a distribution is fully trusted
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # entries of a covariance


def with_head(mask: NDArray[np.bool_], parts: NDArray[np.uint8] | None) -> NDArray[np.bool_]:
    """Return the person's mask [H, W] with the locks, hat and ears that it lacks, by ``parts`` [H, W] if known.

    The mask's own outline is finer than that of ``parts``, so thin strips beside it are left out.
    """
    if parts is None:
        return mask
    worn = np.isin(parts, (HeadPart.HAIR, HeadPart.HAT, HeadPart.LEFT_EAR, HeadPart.RIGHT_EAR))
    side = max(3, int(_MIN_LOCK_FRACTION * np.sqrt(worn.sum())))
    missing = cv2.morphologyEx((worn & ~mask).astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8)) > 0
    near = cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0  # opening rounds corners
    _, label = cv2.connectedComponents(missing.astype(np.uint8))
    return mask | (missing & np.isin(label, np.unique(label[missing & near])))


def person_mask(picture: NDArray[np.uint8], body: DetectedBody) -> NDArray[np.bool_]:
    """Return the mask [H, W] of the person ``body`` in a picture (RGB uint8 [H, W, 3]), one connected component."""
    mask = body.mask > 0.5
    if not mask.any():
        return mask
    box = bounds(mask).astype(int)
    height = float(max(box[2] - box[0], box[3] - box[1]))
    reach = int(0.08 * height) + 2
    area = (
        slice(max(box[1] - reach, 0), min(box[3] + reach, mask.shape[0])),
        slice(max(box[0] - reach, 0), min(box[2] + reach, mask.shape[1])),
    )
    part, soft = np.ascontiguousarray(picture[area]), np.ascontiguousarray(body.mask[area])
    ankles = min(body.point("left_ankle")[1], body.point("right_ankle")[1]) - area[0].start
    inner = (soft > 0.5).astype(np.uint8)
    for band, window, shrink in _ROUNDS:
        size = inner.shape[1] // shrink, inner.shape[0] // shrink
        small = [cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (part, soft)]
        start = cv2.resize(inner.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        scale = height / shrink
        odds = _odds(small[0], small[1], start, scale * band, scale * window, ankles / shrink, scale)
        inner = (cv2.resize(odds, inner.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0).astype(np.uint8)
    out = np.zeros_like(mask)
    out[area] = _largest(inner)
    return out


def _odds(
    picture: NDArray[np.uint8],
    soft: F32,
    mask: NDArray[np.bool_],
    band: float,
    window: float,
    ankles: float,
    height: float,
) -> F32:
    """Return values [H, W] above zero inside the person; only the band around the mask's outline is re-estimated."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    grown = cv2.dilate(inside, np.ones((3, 3), np.uint8))
    ridge = mask & (inside >= grown - 0.3) & (inside >= max(_MIN_THICKNESS_FRACTION * height, 1.5))
    person = (inside > band) | ridge
    room = outside > band
    rows, columns = np.nonzero((inside <= band) & (outside <= band))
    colours = picture.astype(np.float32)
    own = _Colours(colours, person, round(window)).at(rows, columns)
    other = _Colours(colours, room, round(window)).at(rows, columns)
    values = colours[rows, columns]
    as_person, as_room = own.log_likelihood(values), other.log_likelihood(values)
    low = rows > ankles - _FLOOR_FRACTION * height
    for shade in _SHADOW_FACTORS:
        shadow = other.log_likelihood(values, shade) - np.float32(_SHADOW_LOG_ODDS * (1 - shade))
        as_room = np.where(low, np.maximum(as_room, shadow), as_room)
    certainty = np.minimum(own.certainty, other.certainty)
    probability = np.clip(soft[rows, columns], 1e-3, 1 - 1e-3)
    colour_odds = np.clip(as_person - as_room, -_MAX_LOG_ODDS, _MAX_LOG_ODDS) * certainty
    network_odds = np.log(probability / (1 - probability))
    log_odds = _COLOUR_WEIGHT * colour_odds + _NETWORK_WEIGHT * network_odds
    odds = np.where(mask, 1.0, -1.0).astype(np.float32)
    odds[rows, columns] = np.tanh(log_odds / 2)
    smooth = cv2.ximgproc.fastGlobalSmootherFilter(picture, odds, _SMOOTHNESS, _EDGE_LEVELS)
    return np.asarray(smooth, np.float32)


class _Colours:
    """Mean and covariance of the colours of ``members`` in a window around each pixel."""

    def __init__(self, colours: F32, members: NDArray[np.bool_], radius: int) -> None:
        weight = members.astype(np.float32)
        side = 2 * max(radius, 2) + 1

        def total(values: F32) -> F32:
            return np.asarray(
                cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32
            )

        # sums of squares about the mean of all members, to keep float32's precision
        self._middle: F32 = colours[members].mean(axis=0) if members.any() else np.zeros(3, np.float32)
        centred = colours - self._middle
        self._count = total(weight)
        self._mean = total(centred * weight[..., None])
        self._products = [total(centred[..., i] * centred[..., j] * weight) for i, j in _PAIRS]

    def at(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> _Local:
        """Return the distributions at N pixels."""
        count: F32 = self._count[rows, columns]
        safe: F32 = np.maximum(count, np.float32(1))
        mean: F32 = self._mean[rows, columns] / safe[:, None]
        spread: list[F32] = [
            product[rows, columns] / safe - mean[:, i] * mean[:, j]
            for product, (i, j) in zip(self._products, _PAIRS, strict=True)
        ]
        certainty: F32 = np.minimum(count / _SURE_COUNT_PX, np.float32(1))
        return _Local(mean + self._middle, spread, certainty)


@dataclass
class _Local:
    """One normal distribution of colours for each of N pixels."""

    mean: F32
    spread: list[F32]
    certainty: F32
    """From 0 to 1, by the number of members in the window."""

    def log_likelihood(self, values: F32, shade: float = 1.0) -> F32:
        """Return the log likelihood [N] of values [N, 3] under colours that are ``shade`` times as bright."""
        extra = np.float32(_NOISE_LEVELS**2)
        a, b, c, d, e, f = (np.float32(shade * shade) * s for s in self.spread)
        a, d, f = a + extra, d + extra, f + extra
        x, y, z = (values - np.float32(shade) * self.mean).T
        ca, cb, cc = d * f - e * e, c * e - b * f, b * e - c * d  # cofactors
        cd, ce, cf = a * f - c * c, b * c - a * e, a * d - b * b
        volume = np.maximum(a * ca + b * cb + c * cc, 1e-3)
        distance = (ca * x * x + cd * y * y + cf * z * z + 2 * (cb * x * y + cc * x * z + ce * y * z)) / volume
        return np.asarray(-0.5 * (np.minimum(distance, 50) + np.log(volume)), np.float32)


def _largest(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the largest connected component."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask > 0
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))


def read_mask(source: MaskSource, photo: Photo) -> NDArray[np.bool_]:
    """Return the mask [H, W] of ``photo.picture``, true on the person.

    A file is white or opaque on the person, black or transparent elsewhere, and has the photograph's upright size.
    Raises FormatError, one line.
    """
    if isinstance(source, np.ndarray):
        return _checked(_array(source, photo), "the mask")
    drawn = read_photo(source, max(photo.picture.shape[:2]))
    if drawn.size != photo.size:
        raise FormatError(
            f"{source}: the mask has {drawn.size[0]} x {drawn.size[1]} pixels, its picture {photo.size[0]} x "
            f"{photo.size[1]} (upright); draw it over the picture, at the same size"
        )
    values = drawn.picture.max(axis=2) if drawn.alpha is None else drawn.alpha
    return _checked(values > 127, str(source))


def _array(mask: NDArray[np.bool_], photo: Photo) -> NDArray[np.bool_]:
    if mask.dtype != np.bool_ or mask.shape != photo.picture.shape[:2]:
        raise FormatError(
            f"a mask needs booleans {photo.picture.shape[:2]}, one for each pixel, not {mask.dtype} {mask.shape}"
        )
    return mask


def _checked(mask: NDArray[np.bool_], name: str) -> NDArray[np.bool_]:
    share = float(mask.mean())
    if not _MIN_FRACTION <= share <= _MAX_FRACTION:
        raise FormatError(
            f"{name}: {share:.1%} of the mask are white, which is not a person; make the person white, all else black"
        )
    return mask
