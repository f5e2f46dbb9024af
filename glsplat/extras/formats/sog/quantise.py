"""Quantise numbers to 256 values, and sets of coefficients to a palette: deterministic k-means in bounded time."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

SIZE = 256
_BINS = 1 << 14
_EVEN = 0.25  # share of the initial codes that is spread evenly over the range
_ROUNDS = 10

_PALETTE_ROUNDS = 2
_GROUP = 256  # neighbouring sets
_NEAR = 8  # groups compared with a row
_CHUNK = 4096  # rows compared at a time

Rows = NDArray[np.float32]


def codebook(values: NDArray[np.floating]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return 256 numbers in ascending order, and for each of the finite ``values`` the index of the nearest.

    Up to 256 different values (as float32) are kept exactly. Errors of more are at most 1/60 of the range, and much
    smaller where values are dense.
    """
    flat = np.ascontiguousarray(values, np.float32).ravel()
    book = np.full(SIZE, flat[0] if flat.size else 0, np.float32)
    few = np.unique(flat[: 16 * SIZE])  # of all values only if these are few
    few = np.unique(flat) if len(few) <= SIZE else few
    if len(few) <= SIZE:
        book[: len(few)] = few
        book[len(few) :] = few[-1] if len(few) else 0
    elif flat.size:
        book = _means_of(flat)
    index = np.searchsorted((book[1:].astype(np.float64) + book[:-1]) / 2, flat).astype(np.uint8)
    return book, index.reshape(values.shape)


def _means_of(flat: NDArray[np.float32]) -> NDArray[np.float32]:
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


def palette_size(count: int) -> int:
    """Return the sets for ``count`` splats: the largest power of two up to it, at most 65536 (as splat-transform)."""
    return min(1 << 16, 1 << max(count.bit_length() - 1, 0)) if count else 0


def palette(rows: Rows, size: int) -> tuple[Rows, NDArray[np.int64]]:
    """Return at most ``size`` rows [P, D] for all [N, D], and each one's row index; all rows are in use.

    Rows are halved at the mean of their widest dimension, those with the largest squared error first, until there
    are enough parts; then two rounds of k-means compare each row with the sets of the eight nearest groups of 256
    (2048 sets: all, in a small palette). Up to ``size`` different rows are kept exactly. The time grows with
    N D (log P + 3 x 2048), not with N P; the same rows give the same result.
    """
    with np.errstate(all="ignore"):  # squares of 1e30 overflow
        return _palette(rows, size)


def _palette(rows: Rows, size: int) -> tuple[Rows, NDArray[np.int64]]:
    order, starts = _halved(rows, size)
    grouped = rows[order]
    lengths = np.diff([*starts, len(rows)])
    centres = np.add.reduceat(grouped.astype(np.float64), starts, axis=0) / lengths[:, None]
    labels = np.repeat(np.arange(len(starts)), lengths)
    firsts = starts[::_GROUP]
    for _ in range(_PALETTE_ROUNDS if len(starts) == size else 0):
        labels, errors = _nearest(grouped, firsts, centres.astype(np.float32))
        counts = np.bincount(labels, minlength=len(centres))
        for axis in range(rows.shape[1]):
            sums = np.bincount(labels, grouped[:, axis], len(centres))
            centres[:, axis] = np.where(counts > 0, sums / np.maximum(counts, 1), centres[:, axis])
        empty = np.flatnonzero(counts == 0)  # each takes a row with the largest error
        centres[empty] = grouped[np.argsort(-errors, kind="stable")[: len(empty)]]
    if len(starts) == size:
        labels, _ = _nearest(grouped, firsts, centres.astype(np.float32))
    used, labels = np.unique(labels, return_inverse=True)
    found = np.empty(len(rows), np.int64)
    found[order] = labels
    return centres[used].astype(np.float32), found


def _halved(rows: Rows, size: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an order of the rows in ``size`` contiguous parts, and their starts; fewer if rows repeat."""
    order = np.arange(len(rows))
    waiting: list[tuple[float, int, int]] = []
    starts = {0}

    def wait(start: int, stop: int) -> None:
        if stop - start > 1:
            part = rows[order[start:stop]]
            error = float(part.var(axis=0, dtype=np.float64).sum()) * (stop - start)
            # equal rows have a rounding error
            if error > 0 and (part != part[0]).any():
                heapq.heappush(waiting, (-error, start, stop))

    wait(0, len(rows))
    while waiting and len(starts) < size:
        _, start, stop = heapq.heappop(waiting)
        part = rows[order[start:stop]]
        widest = part[:, int(part.var(axis=0, dtype=np.float64).argmax())]
        above = widest > widest.mean(dtype=np.float64)
        mine = order[start:stop]
        middle = stop - int(above.sum())
        order[start:stop] = np.concatenate([mine[~above], mine[above]])
        starts.add(middle)
        wait(start, middle)
        wait(middle, stop)
    return order, np.array(sorted(starts))


def _nearest(rows: Rows, firsts: NDArray[np.int64], centres: Rows) -> tuple[NDArray[np.int64], Rows]:
    """Return for each row the nearest centre of the neighbouring groups, and the squared distance."""
    groups = len(firsts)
    edges = np.minimum(np.arange(groups + 1) * _GROUP, len(centres))
    middles = np.add.reduceat(centres, edges[:-1], axis=0) / np.diff(edges)[:, None]
    apart = (middles**2).sum(1)[:, None] + (middles**2).sum(1) - 2 * middles @ middles.T
    np.fill_diagonal(apart, -1)
    labels, errors = np.empty(len(rows), np.int64), np.empty(len(rows), np.float32)
    squares = (centres * centres).sum(axis=1)
    stops = [*firsts[1:], len(rows)]
    for group in range(groups):
        near = np.sort(np.argsort(apart[group], kind="stable")[:_NEAR])
        mine = np.concatenate([np.arange(edges[one], edges[one + 1]) for one in near])
        theirs, lengths = centres[mine].T, squares[mine]
        for at in range(int(firsts[group]), int(stops[group]), _CHUNK):
            part = rows[at : min(at + _CHUNK, int(stops[group]))]
            far = lengths - 2 * (part @ theirs)
            best = far.argmin(axis=1)
            labels[at : at + len(part)] = mine[best]
            errors[at : at + len(part)] = far[np.arange(len(part)), best] + (part * part).sum(axis=1)
    return labels, errors
