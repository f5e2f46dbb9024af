"""Quantise numbers to 256 values: deterministic k-means in one dimension, on a histogram."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIZE = 256
_BINS = 1 << 14
_EVEN = 0.25  # share of the initial codes that is spread evenly over the range
_ROUNDS = 10


def codebook(values: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return 256 numbers in ascending order, and for each of the finite ``values`` the index of the nearest.

    Up to 256 different values (as float32) are kept exactly. Errors of more are at most 1/60 of the range, and much
    smaller where values are dense.
    """
    flat = np.ascontiguousarray(values, np.float32).ravel()
    book = np.full(SIZE, flat[0] if flat.size else 0, np.float32)
    few = _distinct(flat)
    if few is not None:
        book[: len(few)] = few
        book[len(few) :] = few[-1] if len(few) else 0
    elif flat.size:
        book = _means(flat)
    index = np.searchsorted((book[1:].astype(np.float64) + book[:-1]) / 2, flat).astype(np.uint8)
    return book, index.reshape(values.shape)


def _distinct(flat: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Return the distinct values in order; None if they exceed a codebook."""
    if len(np.unique(flat[: 16 * SIZE])) > SIZE:
        return None
    few = np.unique(flat)
    return few if len(few) <= SIZE else None


def _means(flat: NDArray[np.float32]) -> NDArray[np.float32]:
    low, high = float(flat.min()), float(flat.max())
    bins = ((flat.astype(np.float64) - low) * ((_BINS - 1) / (high - low))).astype(np.int32)
    counts = np.bincount(bins, minlength=_BINS).astype(np.float64)
    sums = np.bincount(bins, flat, _BINS).astype(np.float64)
    # the cube root of the density is optimal for squared errors in the limit of many codes
    share = np.cbrt(counts)
    share = (1 - _EVEN) * share / share.sum() + _EVEN / _BINS
    cells = np.minimum((np.cumsum(share) - share / 2) * SIZE, SIZE - 1).astype(np.int64)
    start = _centres(cells, counts, sums, np.linspace(low, high, SIZE))
    used = counts > 0
    counts, sums = counts[used], sums[used]
    at = sums / counts
    book = start
    for _ in range(_ROUNDS):
        nearest = np.searchsorted((book[1:] + book[:-1]) / 2, at)
        book = _centres(nearest, counts, sums, book)
    # k-means favours frequent values; keep the start if rare ones would exceed the promised error
    if _worst(book, at) > _worst(start, at) and _worst(book, at) > (high - low) / 64:
        book = start
    return np.sort(book).astype(np.float32)


def _centres(
    cells: NDArray[np.int64], counts: NDArray[np.float64], sums: NDArray[np.float64], old: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean of each cell; the old centre of an empty one."""
    number = np.bincount(cells, counts, SIZE)
    return np.sort(np.where(number > 0, np.bincount(cells, sums, SIZE) / np.maximum(number, 1), old))


def _worst(book: NDArray[np.float64], at: NDArray[np.float64]) -> float:
    return float(np.abs(book[np.searchsorted((book[1:] + book[:-1]) / 2, at)] - at).max())
