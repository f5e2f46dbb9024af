"""Find a mark in pictures that were cropped, scaled and compressed, with a bound on the false alarm probability.

A median filter's residual of each picture is averaged, as the mark stays in place while the content moves, and divided
by the local variance. For each scale tried, the ring's bins are computed (a Fourier transform at these frequencies);
one inverse transform scores all positions of the tile.

**False alarms.** Without the mark, or under another key, a key's phases are uniform and independent of the picture. The
score sum(a cos(phase)) over the sync bins, a their magnitudes, exceeds t sqrt(sum(a^2) / 2) with probability at most
exp(-t^2 / 2): E exp(l a cos) = I0(l a) <= exp(l^2 a^2 / 4), and Chernoff's bound, for any picture. It is multiplied by
the number of positions and scales tried (Bonferroni), and by 2^-16: the data bins' phases are independent of the sync
bins', so the decoded word is uniform, and the CRC matches one word in 2^16.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize

from glsplat.arrays import F32
from glsplat.errors import GlsplatError
from glsplat.extras.watermark.code import CHECK_BITS, Payload, decode
from glsplat.extras.watermark.pattern import BAND, TILE, Pattern, pattern_of

__all__ = ["SCALES", "WINDOW", "Found", "detect", "residual_of", "search"]

SCALES = (0.5, 2.0)
"""Least and largest scale tried: picture pixels per rendered pixel."""

WINDOW = 30
"""Pictures per average."""

ALARM = 1e-6
"""Largest false alarm probability of a reported mark."""

_EMPTY = 0.05  # whitened level; margins below it are cut off as background
_GRID = 2 * TILE  # positions per side: every half pixel
_BATCH = 24  # scales computed at once
_CANDIDATES = 6  # best scales that are decoded, each at its best position
_SCALE_STEP = 0.7  # of the step that shifts the finest wave by a quarter at the picture's edge
_MAX_RESIDUAL = 8.0  # levels; larger residuals belong to the picture
_BLUR_PX = 1.5  # standard deviation of the neighbourhood of the local variance
_NOISE_FLOOR = 1.2  # levels; least noise assumed
_MAX_WEIGHT = 2.0  # times the typical magnitude, so that no single bin dominates

C64 = NDArray[np.complex64]


@dataclass(frozen=True, slots=True)
class Found:
    """A detected mark."""

    server: int
    session: int
    chance: float  # bound on the false alarm probability
    scale: float  # picture pixels per rendered pixel
    frames: int  # pictures averaged

    def __str__(self) -> str:
        return f"server {self.server:04x}, session {self.session:08x} (false alarm: {self.chance:.1g})"


def detect(frames: Iterable[NDArray[np.uint8]], key: bytes, window: int = WINDOW) -> Found | None:
    """Return the mark of ``key`` in ``frames``, or None: RGB or RGBA pictures [H, W, 3|4] of one size, or luma [H, W].

    The mean of every ``window`` pictures is searched, that of the remaining ones, and last the mean of all, until a
    mark is found. The n-th search multiplies ``Found.chance`` by n (n + 1), so the sum stays below one in a million.
    Raises GlsplatError for no pictures or pictures of another form.
    """
    if window < 1:
        raise GlsplatError(f"a window needs at least 1 picture, not {window}")
    pattern = pattern_of(key)
    total = part = np.zeros((0, 0), np.float32)
    count = since = searches = 0

    def found_in(sum_: F32, pictures: int) -> Found | None:
        nonlocal searches
        searches += 1
        return search(sum_ / np.float32(pictures), pattern, searches * (searches + 1), pictures)

    for frame in frames:
        rest = residual_of(frame)
        if count and rest.shape != total.shape:
            raise GlsplatError(f"pictures of one size are needed, not {_size(total)} and then {_size(rest)}")
        total = total + rest if count else rest
        part = part + rest if since else rest
        count, since = count + 1, since + 1
        if since == window:
            if (found := found_in(part, since)) is not None:
                return found
            since = 0
    if not count:
        raise GlsplatError("a mark is searched in at least 1 picture, found none")
    if since and (found := found_in(part, since)) is not None:
        return found
    return found_in(total, count) if searches > 1 else None


def residual_of(frame: NDArray[np.uint8]) -> F32:
    """Return the luma [H, W] in levels without its 5x5 median, clipped."""
    if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8 or min(frame.shape, default=0) < 1:
        raise GlsplatError("a mark is searched in pictures of uint8, [H, W, 3], [H, W, 4] or [H, W]")
    luma = np.ascontiguousarray(frame)
    if luma.ndim == 3 and luma.shape[2] in (3, 4):
        luma = cv2.cvtColor(luma, cv2.COLOR_RGB2GRAY if luma.shape[2] == 3 else cv2.COLOR_RGBA2GRAY)
    if luma.ndim != 2:
        raise GlsplatError(f"a picture is [H, W, 3], [H, W, 4] or [H, W], not {frame.shape}")
    rest = luma.astype(np.float32) - cv2.medianBlur(luma, 5)
    return np.clip(rest, -_MAX_RESIDUAL, _MAX_RESIDUAL)


def search(mean: F32, pattern: Pattern, times: int = 1, frames: int = 1) -> Found | None:
    """Return the mark in the mean of ``residual_of`` of ``frames`` pictures; its chance is multiplied by ``times``."""
    residual = _whitened(mean)
    scales = _scales(max(residual.shape))
    spectra = _spectra(residual, pattern, scales)
    weights = _weights(spectra, pattern)
    scores = _scores(spectra * weights, pattern)
    tries = scores.size * times
    # the best position of each scale, then the best of these
    flat = scores.reshape(len(scales), -1)
    positions = flat.argmax(axis=1)
    best = flat[np.arange(len(scales)), positions]
    for index in np.argsort(best)[::-1][:_CANDIDATES]:
        chance = _chance(float(best[index]), tries)
        if chance > ALARM:
            break
        row, column = divmod(int(positions[index]), _GRID)
        start = (float(scales[index]), column * TILE / _GRID, row * TILE / _GRID)
        payload, scale = _refine(residual, pattern, start)
        if payload is not None:
            return Found(payload.server, payload.session, chance, scale, frames)
    return None


def _chance(score: float, tries: int) -> float:
    return float(min(1.0, np.exp(np.log(tries) - score * max(score, 0.0) / 2 - CHECK_BITS * np.log(2))))


def _size(image: F32) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"


def _whitened(mean: F32) -> F32:
    """Return the residual over its local variance, the matched filter of a weak mark, without empty margins."""
    variance = cv2.GaussianBlur(mean * mean, (0, 0), _BLUR_PX)
    weighed = mean / (variance + _NOISE_FLOOR**2)
    there = abs(weighed) > _EMPTY
    if not there.any():
        return np.zeros((1, 1), np.float32)
    rows, columns = (np.flatnonzero(there.any(axis=axis)) for axis in (1, 0))
    return weighed[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


@lru_cache(maxsize=32)
def _scales(length: int) -> F32:
    """Return scales so dense that a mark ``length`` pixels long is in step with one of them."""
    low, high = np.log(SCALES)
    return np.exp(np.linspace(low, high, 1 + int(np.ceil((high - low) / _step(length))))).astype(np.float32)


def _step(length: int) -> float:
    """Return the logarithmic step between scales."""
    return _SCALE_STEP * TILE / (BAND[1] * max(length, TILE))


def _waves(length: int, scales: NDArray[np.floating], most: int) -> C64:
    """Return exp(-2 pi i k x / (TILE scale)) [scales, length, most + 1], k = 0 .. most, x from the picture's middle."""
    x = np.arange(length) - length // 2
    first = np.exp(-2j * np.pi / TILE * x / np.asarray(scales, np.float64)[:, None]).astype(np.complex64)
    waves = np.empty((len(scales), length, most + 1), np.complex64)
    waves[..., 0] = 1
    for k in range(1, most + 1):
        np.multiply(waves[..., k - 1], first, out=waves[..., k])
    return waves


def _bins(residual: F32, pattern: Pattern, across: C64, down: C64) -> C64:
    """Return the bins [S, N] at S scales, from the ``_waves`` of both axes."""
    height, width = residual.shape
    count, most = len(across), across.shape[2] - 1
    columns = np.ascontiguousarray(across.transpose(1, 0, 2)).view(np.float32).reshape(width, -1)
    rows = (residual @ columns).view(np.complex64).reshape(height, count, most + 1).transpose(1, 0, 2)
    both = np.concatenate([down, down[..., :0:-1].conj()], axis=2)  # ky = 0 .. most, then -most .. -1
    return (both.transpose(0, 2, 1) @ rows)[:, pattern.ky, pattern.kx]


def _spectra(residual: F32, pattern: Pattern, scales: F32) -> C64:
    most = int(BAND[1])
    parts = []
    for first in range(0, len(scales), _BATCH):
        some = scales[first : first + _BATCH]
        waves = [_waves(length, some, most) for length in residual.shape]
        parts.append(_bins(residual, pattern, waves[1], waves[0]))
    return np.concatenate(parts)


def _weights(spectra: C64, pattern: Pattern) -> F32:
    """Return weights [S, N]: one over the typical magnitude at that frequency, less for outliers."""
    power = spectra.real**2 + spectra.imag**2
    typical = np.sqrt(power @ _neighbours(pattern)) + np.float32(1e-12)
    return np.minimum(1 / typical, _MAX_WEIGHT / np.maximum(np.sqrt(power), 1e-12))


@lru_cache(maxsize=8)
def _neighbours(pattern: Pattern) -> F32:
    """Return the matrix [N, N] that averages bins over a ring one cycle per tile wide."""
    radius = np.hypot(pattern.kx, pattern.ky)
    near = (abs(radius[:, None] - radius) <= 0.5).astype(np.float32)
    return near / near.sum(axis=0)


def _scores(weighed: C64, pattern: Pattern) -> F32:
    """Return scores [S, GRID, GRID] in standard deviations, by row and column of the picture's middle in the tile."""
    sync, kx, ky = pattern.sync, pattern.kx[pattern.sync], pattern.ky[pattern.sync]
    values = (weighed[:, sync] * pattern.phase[sync].conj()).conj()
    deviation = np.sqrt((values.real**2 + values.imag**2).sum(axis=1) / 2) + np.float32(1e-12)
    spectrum = np.zeros((len(weighed), _GRID, _GRID // 2 + 1), np.complex64)
    spectrum[:, ky, kx] = values
    axis = kx == 0  # this column holds both halves
    spectrum[:, -ky[axis], 0] = values[:, axis].conj()
    total = fft.irfft2(spectrum, (_GRID, _GRID), norm="forward") / 2
    return total / deviation[:, None, None]


def _refine(residual: F32, pattern: Pattern, start: tuple[float, float, float]) -> tuple[Payload | None, float]:
    """Return the payload and the scale at the best score near ``start`` (scale, x, y).

    Near: within the step of the search. With a weak score, a better one further away would be chance.
    """
    most, sync = int(BAND[1]), pattern.sync
    waves = (2j * np.pi / TILE * np.stack([pattern.kx, pattern.ky], axis=1)).astype(np.complex64)

    def received(at: NDArray[np.float64]) -> C64:
        across, down = (_waves(n, np.exp(at[:1]), most) for n in residual.shape[::-1])
        bins = _bins(residual, pattern, across, down)
        return (bins * _weights(bins, pattern))[0] * np.exp(-waves @ at[1:].astype(np.float32))

    def loss(at: NDArray[np.float64]) -> float:
        bins = received(at)[sync]
        return -float((bins * pattern.phase[sync].conj()).real.sum() / np.linalg.norm(bins))

    at = np.array([np.log(start[0]), *start[1:]])
    near = np.array([_step(max(residual.shape)) / 2, 0.5, 0.5])
    simplex = at + np.vstack([np.zeros(3), np.diag(near / 2)])
    options = {"initial_simplex": simplex, "maxfev": 60, "xatol": 1e-4, "fatol": 1e-3}
    bounds = optimize.Bounds(at - near, at + near)
    at = optimize.minimize(loss, at, method="Nelder-Mead", bounds=bounds, options=options).x
    return decode(pattern.soft(received(at))), float(np.exp(at[0]))
