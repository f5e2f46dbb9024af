"""Morton order: neighbours in space are close in a file."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BITS = 10  # of each axis: a code has 30
_CROWD = 256  # splats of a cell above which it has its own grid


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
