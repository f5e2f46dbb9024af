"""Depth: how far away is what a picture shows, on a grid, by which a client puts a late picture where its eyes are now.

Inverse depth is what is stored and interpolated: of a plane it is linear in the picture, and steps are fine where what
is near moves most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["GRID_SIDE", "DepthGrid", "grid_of", "read_grids"]

GRID_SIDE = 32
"""Columns and rows of a server's grids (docs/vr.md has what other numbers of them are worth)."""

_MAX_SIDE = 256  # columns and rows that a client takes


@dataclass(frozen=True, slots=True)
class DepthGrid:
    """Of one eye. Point (column, row) is at the parts column / (columns - 1), row / (rows - 1) of the picture."""

    columns: int
    rows: int
    low: float  # 1 / metres along the camera's axis, of byte 0
    high: float  # of byte 255
    data: bytes  # row by row from the top

    def metres(self) -> NDArray[np.float64]:
        """[rows, columns] camera z."""
        steps = np.frombuffer(self.data, np.uint8).reshape(self.rows, self.columns)
        return 1 / (self.low + (self.high - self.low) / 255 * steps)

    @staticmethod
    def fields(grids: tuple[DepthGrid, ...]) -> dict[str, Any]:
        """What a reply's JSON says of those of its eyes, which have one shape; their ``data`` follow it."""
        first = grids[0]
        return {
            "grid": (first.columns, first.rows),
            "inverse": [(float(f"{grid.low:.6g}"), float(f"{grid.high:.6g}")) for grid in grids],
        }


def grid_of(inverse: NDArray[np.floating]) -> DepthGrid:
    """Of inverse depths [rows, columns], NaN where nothing is shown: such points go on from those beside them."""
    filled = _filled(np.array(inverse, np.float64))
    low, high = float(filled.min()), float(filled.max())
    steps = np.rint((filled - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)
    return DepthGrid(filled.shape[1], filled.shape[0], low, high, steps.tobytes())


def read_grids(fields: Any, data: bytes) -> tuple[DepthGrid, ...]:
    """What ``DepthGrid.fields`` said and the bytes behind it. Raises ValueError for what does not fit together."""
    columns, rows = map(int, fields["grid"])
    ranges = [(float(low), float(high)) for low, high in fields["inverse"]]
    if not (2 <= columns <= _MAX_SIDE and 2 <= rows <= _MAX_SIDE and len(data) == len(ranges) * columns * rows):
        raise ValueError(f"{len(ranges)} grids of {columns} x {rows} in {len(data)} bytes")
    if not all(0 < low <= high < np.inf for low, high in ranges):
        raise ValueError("inverse depths need to be above 0")
    parts = (data[i * columns * rows : (i + 1) * columns * rows] for i in range(len(ranges)))
    return tuple(DepthGrid(columns, rows, *range_, part) for range_, part in zip(ranges, parts, strict=True))


def _filled(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ring by ring, each point the mean of those of its four neighbours that are known; 0.5 where none is at all."""
    known = np.isfinite(inverse)
    if not known.any():
        return np.full_like(inverse, 0.5)
    inverse[~known] = 0
    while not known.all():
        around, sums = np.pad(known, 1).astype(np.int32), np.pad(inverse, 1)
        count = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
        total = sums[:-2, 1:-1] + sums[2:, 1:-1] + sums[1:-1, :-2] + sums[1:-1, 2:]
        new = ~known & (count > 0)
        inverse[new] = total[new] / count[new]
        known |= new
    return inverse
