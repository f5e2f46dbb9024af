"""Quantise splats' attributes into planes of bytes, and read them back.

A plane holds one byte of every splat. Neighbours are close in the file (``morton_order``), so that planes pack well;
positions and colours are differences from splat to splat, which pack better still.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64

U8 = NDArray[np.uint8]

THINNEST = 1e-6
"""Scale below which a splat is flat and 0 is written, metres."""

WEIGHT = 4095
"""Sum of a splat's weights in steps, so that the first is not stored; 8 bits would cost 10 dB of a near face."""

_STEPS = 65535  # of a position across the box
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # of w, x, y, z, by the omitted one
_SHIFTS = np.array([0, 10, 20], np.uint32)


def to_planes(rows: NDArray[Any]) -> bytes:
    """Pack rows [N, ...] of whole numbers: all first bytes, then all second bytes, ..., little endian."""
    flat = np.ascontiguousarray(rows.reshape(len(rows), -1).astype(rows.dtype.newbyteorder("<")))
    return flat.view(np.uint8).reshape(len(rows), -1).T.tobytes()


def from_planes(data: bytes, count: int, dtype: str) -> NDArray[Any]:
    """Unpack ``data`` to rows [N, M]; ``dtype`` is little endian."""
    planes = np.frombuffer(data, np.uint8).reshape(-1, count)
    return np.ascontiguousarray(planes.T).view(dtype)


def running(differences: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return running sums [N, M] of differences down the rows, modulo the numbers' range."""
    whole: NDArray[np.int64] = np.cumsum(differences.astype(np.int64), axis=0) % (np.iinfo(differences.dtype).max + 1)
    return whole


def mean_steps(means: F32, low: F64, high: F64) -> NDArray[np.uint16]:
    """Quantise positions in the box to differences [N, 3] of steps, zigzag (0, -1, 1, -2, ... are 0, 1, 2, 3, ...)."""
    extent = np.where(high > low, high - low, 1.0)
    steps = np.rint((means - low) / extent * _STEPS).astype(np.int64)
    change = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int64))
    change = (change + 32768) % 65536 - 32768
    return np.where(change < 0, -2 * change - 1, 2 * change).astype(np.uint16)


def means_of(zigzag: NDArray[np.uint16], low: F64, high: F64) -> F32:
    """Return positions [N, 3], metres."""
    whole = zigzag.astype(np.int64)
    change = (whole >> 1) ^ -(whole & 1)
    return (low + (high - low) * (np.cumsum(change, axis=0) % 65536) / _STEPS).astype(np.float32)


def quat_bits(quats: F32) -> NDArray[np.uint32]:
    """Pack unit quaternions wxyz to [N]: the three smaller numbers in 10 bits each, and the index of the fourth."""
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    signs = np.where(quats[rows, largest] < 0, -1.0, 1.0)
    rest = np.take_along_axis(quats.astype(np.float64) * signs[:, None], _OTHERS[largest], axis=1)
    steps = np.rint((rest * np.sqrt(2) + 1) / 2 * 1023).clip(0, 1023).astype(np.uint32)
    return (steps << _SHIFTS).sum(axis=1).astype(np.uint32) | largest.astype(np.uint32) << np.uint32(30)


def quats_of(bits: NDArray[np.uint32]) -> F32:
    """Unpack quaternions [N, 4] wxyz."""
    steps = (bits[:, None] >> _SHIFTS) & np.uint32(1023)
    rest = (steps / 1023 * 2 - 1) / np.sqrt(2)
    largest = (bits >> np.uint32(30)).astype(np.intp)
    out = np.empty((len(bits), 4))
    np.put_along_axis(out, _OTHERS[largest], rest, axis=1)
    out[np.arange(len(bits)), largest] = np.sqrt(np.maximum(0, 1 - (rest**2).sum(axis=1)))
    return (out / np.linalg.norm(out, axis=1, keepdims=True)).astype(np.float32)


def scale_steps(scales: F32, span: tuple[float, float]) -> U8:
    """Quantise scales to steps [N, 3] between the two logarithms; 0 is flat."""
    sizes = np.abs(scales.astype(np.float64))
    low, high = span
    steps = np.rint((np.log(np.maximum(sizes, THINNEST)) - low) / (high - low or 1.0) * 254) + 1
    return np.where(sizes < THINNEST, 0, steps).astype(np.uint8)


def scales_of(steps: U8, span: tuple[float, float]) -> F32:
    """Return scales [N, 3], metres."""
    low, high = span
    table = np.exp(low + (high - low) * (np.arange(256) - 1) / 254)
    table[0] = 0.0
    return table.astype(np.float32)[steps]


def colour_steps(colours: F32, low: F64, high: F64) -> U8:
    """Quantise colours to differences [N, 3] of steps between two colours."""
    extent = np.where(high > low, high - low, 1.0)
    steps = np.rint((colours - low) / extent * 255).astype(np.int64)
    return np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int64)).astype(np.uint8)


def colours_of(differences: U8, low: F64, high: F64) -> F32:
    """Return coefficients [N, 3]."""
    return (low + (high - low) * running(differences) / 255).astype(np.float32)


def weight_steps(weights: F32) -> NDArray[np.uint16]:
    """Quantise weights to [N, K] with the sum WEIGHT: round down, then add one to those that lost most."""
    shares = weights.astype(np.float64) * WEIGHT
    steps = np.floor(shares + 1e-3)
    missing = WEIGHT - steps.sum(axis=1).astype(np.int64)
    rank = np.argsort(np.argsort(steps - shares, axis=1, kind="stable"), axis=1, kind="stable")
    whole: NDArray[np.uint16] = (steps + (rank < missing[:, None])).astype(np.uint16)
    return whole
