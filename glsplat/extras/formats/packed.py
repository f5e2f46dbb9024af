"""What packed formats share: Morton order, rows of a file, and quaternions without their largest component."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError

_BITS = 10  # of each axis: a code has 30
_CROWD = 256  # splats of a cell above which it has its own grid

_OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # by the index of the largest component


def morton_order(means: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the Morton order [N] of finite positions [N, 3], x lowest, on a grid of 1024 cells an axis.

    Cells with more than 256 splats have their own grid, as in SuperSplat; equal positions keep their order.
    """
    order = np.arange(len(means))
    waiting = [(0, len(means))]
    while waiting:
        start, stop = waiting.pop()
        those = order[start:stop]
        here = means[those].astype(np.float64)
        low = here.min(axis=0, initial=np.inf)
        extent = here.max(axis=0, initial=-np.inf) - low
        if not (extent > 0).any():
            continue
        cells = np.divide(here - low, extent, out=np.zeros_like(here), where=extent > 0) * 2**_BITS
        x, y, z = _spread(np.minimum(cells, 2**_BITS - 1).astype(np.uint32)).T
        codes = z << 2 | y << 1 | x
        sequence = np.argsort(codes, kind="stable")
        order[start:stop] = those[sequence]
        ends = np.flatnonzero(np.diff(codes[sequence])) + 1
        starts, stops = np.append(0, ends), np.append(ends, len(those))
        crowds = np.flatnonzero(stops - starts > _CROWD)
        waiting += [(start + int(starts[at]), start + int(stops[at])) for at in crowds]
    return order


def _spread(cells: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return numbers of 10 bits with two zeros before each bit."""
    for shift, mask in ((16, 0xFF0000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cells = (cells ^ (cells << np.uint32(shift))) & np.uint32(mask)
    return cells


def read_rows(file: BinaryIO, at: int, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Read ``count`` rows from the byte ``at``. Raises FormatError if the file has become shorter."""
    file.seek(at)
    data = file.read(count * dtype.itemsize)
    if len(data) != count * dtype.itemsize:
        raise FormatError("the file became shorter while it was read")
    return np.frombuffer(data, dtype, count)


def smallest_three(quats: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[Any]]:
    """Return the index [N] of the largest component, and the others [N, 3], signed so that the largest is positive."""
    largest = np.abs(quats).argmax(axis=1)
    turned = np.where(np.take_along_axis(quats, largest[:, None], axis=1) < 0, -quats, quats)
    return largest, np.take_along_axis(turned, _OTHERS[largest], axis=1)


def with_largest(largest: NDArray[np.integer], three: NDArray[Any]) -> NDArray[Any]:
    """Return the unit quaternions [N, 4] of ``smallest_three``."""
    out = np.empty((len(three), 4), three.dtype)
    np.put_along_axis(out, _OTHERS[largest], three, axis=1)
    out[np.arange(len(out)), largest] = np.sqrt(np.maximum(1 - (three * three).sum(axis=1), 0))
    return out
