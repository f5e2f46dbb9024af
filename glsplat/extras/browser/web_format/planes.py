"""Numbers to bytes and back: each attribute of splats in steps, a plane of bytes for each byte of a splat.

A plane holds one byte of every splat. Splats that lie near each other stand near each other in the file (morton.py),
so that planes pack well; positions and colours are differences from splat to splat, which pack better still.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32, F64

U8 = NDArray[np.uint8]

THINNEST = 1e-6
"""Metres of a scale below which it is written as 0: a splat as thin as that is flat."""

WEIGHT = 4095
"""Steps of all weights of a splat: 8 bits cost 10 dB where a face is near, the sum spares the first of them."""

_STEPS = 65535  # of a position across the box
_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # of w, x, y, z, by the one that is left out
_SHIFTS = np.array([0, 10, 20], np.uint32)


def to_planes(rows: NDArray[Any]) -> bytes:
    """[N, ...] rows of whole numbers: all first bytes, then all second bytes, ..., little endian."""
    flat = np.ascontiguousarray(rows.reshape(len(rows), -1).astype(rows.dtype.newbyteorder("<")))
    return flat.view(np.uint8).reshape(len(rows), -1).T.tobytes()


def from_planes(data: bytes, count: int, dtype: str) -> NDArray[Any]:
    """[N, M] rows again of all of ``data``; ``dtype`` is little endian."""
    planes = np.frombuffer(data, np.uint8).reshape(-1, count)
    return np.ascontiguousarray(planes.T).view(dtype)


def running(differences: NDArray[np.integer]) -> NDArray[np.int64]:
    """[N, M] sums down the rows, of differences modulo the numbers' range."""
    whole: NDArray[np.int64] = np.cumsum(differences.astype(np.int64), axis=0) % (np.iinfo(differences.dtype).max + 1)
    return whole


def mean_steps(means: F32, low: F64, high: F64) -> NDArray[np.uint16]:
    """[N, 3] differences of the steps within the box, zigzag (0, -1, 1, -2, ... are 0, 1, 2, 3, ...)."""
    extent = np.where(high > low, high - low, 1.0)
    steps = np.rint((means - low) / extent * _STEPS).astype(np.int64)
    change = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int64))
    change = (change + 32768) % 65536 - 32768
    return np.where(change < 0, -2 * change - 1, 2 * change).astype(np.uint16)


def means_of(zigzag: NDArray[np.uint16], low: F64, high: F64) -> F32:
    """[N, 3] metres."""
    whole = zigzag.astype(np.int64)
    change = (whole >> 1) ^ -(whole & 1)
    return (low + (high - low) * (np.cumsum(change, axis=0) % 65536) / _STEPS).astype(np.float32)


def quat_bits(quats: F32) -> NDArray[np.uint32]:
    """[N] of unit quaternions wxyz: the three smaller numbers in 10 bits each, and which one is left out."""
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    signs = np.where(quats[rows, largest] < 0, -1.0, 1.0)
    rest = np.take_along_axis(quats.astype(np.float64) * signs[:, None], _OTHERS[largest], axis=1)
    steps = np.rint((rest * np.sqrt(2) + 1) / 2 * 1023).clip(0, 1023).astype(np.uint32)
    return (steps << _SHIFTS).sum(axis=1).astype(np.uint32) | largest.astype(np.uint32) << np.uint32(30)


def quats_of(bits: NDArray[np.uint32]) -> F32:
    """[N, 4] wxyz."""
    steps = (bits[:, None] >> _SHIFTS) & np.uint32(1023)
    rest = (steps / 1023 * 2 - 1) / np.sqrt(2)
    largest = (bits >> np.uint32(30)).astype(np.intp)
    out = np.empty((len(bits), 4))
    np.put_along_axis(out, _OTHERS[largest], rest, axis=1)
    out[np.arange(len(bits)), largest] = np.sqrt(np.maximum(0, 1 - (rest**2).sum(axis=1)))
    return (out / np.linalg.norm(out, axis=1, keepdims=True)).astype(np.float32)


def scale_steps(scales: F32, span: tuple[float, float]) -> U8:
    """[N, 3] steps between the two logarithms; 0 for what is flat."""
    sizes = np.abs(scales.astype(np.float64))
    low, high = span
    steps = np.rint((np.log(np.maximum(sizes, THINNEST)) - low) / (high - low or 1.0) * 254) + 1
    return np.where(sizes < THINNEST, 0, steps).astype(np.uint8)


def scales_of(steps: U8, span: tuple[float, float]) -> F32:
    """[N, 3] metres."""
    low, high = span
    table = np.exp(low + (high - low) * (np.arange(256) - 1) / 254)
    table[0] = 0.0
    return table.astype(np.float32)[steps]


def colour_steps(colours: F32, low: F64, high: F64) -> U8:
    """[N, 3] differences of the steps between two colours."""
    extent = np.where(high > low, high - low, 1.0)
    steps = np.rint((colours - low) / extent * 255).astype(np.int64)
    return np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int64)).astype(np.uint8)


def colours_of(differences: U8, low: F64, high: F64) -> F32:
    """[N, 3] coefficients."""
    return (low + (high - low) * running(differences) / 255).astype(np.float32)


def weight_steps(weights: F32) -> NDArray[np.uint16]:
    """[N, K] of WEIGHT in all: rounded down, then one more for those that lost most."""
    shares = weights.astype(np.float64) * WEIGHT
    steps = np.floor(shares + 1e-3)
    missing = WEIGHT - steps.sum(axis=1).astype(np.int64)
    rank = np.argsort(np.argsort(steps - shares, axis=1, kind="stable"), axis=1, kind="stable")
    whole: NDArray[np.uint16] = (steps + (rank < missing[:, None])).astype(np.uint16)
    return whole
