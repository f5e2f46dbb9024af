"""The person's mask at the picture's resolution, from a network's coarse one. No chance in it: same bytes every time.

The network is right about who is the person and wrong by some pixels about where the outline runs. In a band about
its outline every pixel is asked how well its colour fits the person nearby and the room nearby; the answers are
smoothed along the picture's edges. On the floor a darker room counts as room: that is the person's shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.networks.person import DetectedBody, bounds

__all__ = ["MaskConfig", "person_mask"]

Float = NDArray[np.float32]


@dataclass(frozen=True)
class MaskConfig:
    """Lengths are shares of the person's height, as the network's mask has it."""

    rounds: tuple[tuple[float, float, int], ...] = ((0.015, 0.03, 2), (0.008, 0.02, 1))
    """Half width of the band, half width of the window whose colours are compared, and how much smaller the
    picture is while doing so."""
    core: float = 0.004
    """Parts at least this thick lend their middle line to the person's colours, fingers among them."""
    noise: float = 5.0
    """Standard deviation in 8-bit levels by which colours may differ anyway."""
    net: float = 0.8
    """Weight of the network's own belief, as log odds."""
    trust: float = 0.5
    """Weight of the colours."""
    most: float = 6.0
    """Log odds that one pixel's colour may contribute."""
    smooth: float = 30.0
    """Strength of the smoothing along edges."""
    edge: float = 15.0
    """Difference in 8-bit levels that counts as an edge."""
    shadow: float = 2.0
    """Log odds that a shadow of full darkness costs."""
    floor: float = 0.05
    """How far above the ankles shadows of the floor are seen."""


_SHADES = (1.0, 0.88, 0.76, 0.64, 0.52, 0.4)  # of the room's colour, in the picture's own values


def person_mask(picture: NDArray[np.uint8], body: DetectedBody, config: MaskConfig | None = None) -> NDArray[np.bool_]:
    """[H, W]: where the picture, RGB uint8 [H, W, 3], shows the person ``body``. One connected piece."""
    config = config or MaskConfig()
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
    for band, window, shrink in config.rounds:
        size = inner.shape[1] // shrink, inner.shape[0] // shrink
        small = [cv2.resize(a, size, interpolation=cv2.INTER_AREA) for a in (part, soft)]
        start = cv2.resize(inner.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        scale = height / shrink
        odds = _odds(small[0], small[1], start, scale * band, scale * window, ankles / shrink, scale, config)
        inner = (cv2.resize(odds, inner.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0).astype(np.uint8)
    out = np.zeros_like(mask)
    out[area] = _largest(inner)
    return out


def _odds(
    picture: NDArray[np.uint8],
    soft: Float,
    mask: NDArray[np.bool_],
    band: float,
    window: float,
    ankles: float,
    height: float,
    config: MaskConfig,
) -> Float:
    """[H, W]: above zero inside the person; only the band about the mask's outline is asked again."""
    inside = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    outside = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    grown = cv2.dilate(inside, np.ones((3, 3), np.uint8))
    ridge = mask & (inside >= grown - 0.3) & (inside >= max(config.core * height, 1.5))  # the middle of thin parts
    person = (inside > band) | ridge
    room = outside > band
    rows, columns = np.nonzero((inside <= band) & (outside <= band))
    colours = picture.astype(np.float32)
    own = _Colours(colours, person, round(window), config.noise).at(rows, columns)
    other = _Colours(colours, room, round(window), config.noise).at(rows, columns)
    values = colours[rows, columns]
    fits = own.fit(values)
    misfits = other.fit(values)
    low = rows > ankles - config.floor * height
    for shade in _SHADES[1:]:
        dark = other.fit(values, shade) - np.float32(config.shadow * (1 - shade))
        misfits = np.where(low, np.maximum(misfits, dark), misfits)
    known = np.minimum(own.known, other.known)
    belief = np.clip(soft[rows, columns], 1e-3, 1 - 1e-3)
    belief = np.log(belief / (1 - belief))
    said = config.trust * np.clip(fits - misfits, -config.most, config.most) * known + config.net * belief
    odds = np.where(mask, 1.0, -1.0).astype(np.float32)
    odds[rows, columns] = np.tanh(said / 2)
    return np.asarray(cv2.ximgproc.fastGlobalSmootherFilter(picture, odds, config.smooth, config.edge), np.float32)


class _Colours:
    """Mean and covariance of the colours in a window around each pixel, of those pixels that belong to a set."""

    def __init__(self, colours: Float, members: NDArray[np.bool_], radius: int, noise: float) -> None:
        weight = members.astype(np.float32)
        side = 2 * max(radius, 2) + 1

        def total(values: Float) -> Float:
            return np.asarray(
                cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32
            )

        # sums of squares about the mean of all, so that float32 keeps its digits
        self._middle: Float = colours[members].mean(axis=0) if members.any() else np.zeros(3, np.float32)
        centred = colours - self._middle
        self._count = total(weight)
        self._mean = total(centred * weight[..., None])
        self._products = [total(centred[..., i] * centred[..., j] * weight) for i, j in _PAIRS]
        self._noise = noise

    def at(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> _Local:
        """The distributions at N pixels."""
        count: Float = self._count[rows, columns]
        safe: Float = np.maximum(count, np.float32(1))
        mean: Float = self._mean[rows, columns] / safe[:, None]
        spread: list[Float] = [
            product[rows, columns] / safe - mean[:, i] * mean[:, j]
            for product, (i, j) in zip(self._products, _PAIRS, strict=True)
        ]
        known: Float = np.minimum(count / _ENOUGH, np.float32(1))
        return _Local(mean + self._middle, spread, known, self._noise)


_ENOUGH = np.float32(30)  # pixels that make a distribution
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass
class _Local:
    """One normal distribution of colours for each of N pixels."""

    mean: Float
    spread: list[Float]
    known: Float
    """From 0 to 1: whether there were enough colours to say anything."""
    noise: float

    def fit(self, values: Float, shade: float = 1.0) -> Float:
        """Log likelihood [N] of the values [N, 3], where colours are ``shade`` times as bright as they were."""
        extra = np.float32(self.noise**2)
        a, b, c, d, e, f = (np.float32(shade * shade) * s for s in self.spread)
        a, d, f = a + extra, d + extra, f + extra
        x, y, z = (values - np.float32(shade) * self.mean).T
        ca, cb, cc = d * f - e * e, c * e - b * f, b * e - c * d  # cofactors
        cd, ce, cf = a * f - c * c, b * c - a * e, a * d - b * b
        volume = np.maximum(a * ca + b * cb + c * cc, 1e-3)
        distance = (ca * x * x + cd * y * y + cf * z * z + 2 * (cb * x * y + cc * x * z + ce * y * z)) / volume
        return np.asarray(-0.5 * (np.minimum(distance, 50) + np.log(volume)), np.float32)


def _largest(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """The largest connected piece."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    if count < 2:
        return mask > 0
    return np.asarray(labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()))
