"""What an encoded picture is: its JPEGs, and grids of depth with which a client reprojects a late picture.

Inverse depth is stored and interpolated: it is linear in the picture on a plane, and its steps are finest nearby, where
parallax is largest. A module of its own, as a process that only draws does not import the codec.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

GRID_SIDE = 32
"""Columns and rows of a server's grids (docs/vr.md compares other sizes)."""

_MAX_SIDE = 256  # columns and rows that a client accepts


@dataclass(frozen=True, slots=True)
class DepthGrid:
    """Depths of one eye. Point (column, row) is at column / (columns - 1), row / (rows - 1) of the picture's size."""

    columns: int
    rows: int
    low: float  # 1 / metres along the camera's axis, of byte 0
    high: float  # 1 / metres, of byte 255
    data: bytes  # row by row from the top

    def metres(self) -> NDArray[np.float64]:
        """Return camera z [rows, columns] in metres."""
        steps = np.frombuffer(self.data, np.uint8).reshape(self.rows, self.columns)
        return 1 / (self.low + (self.high - self.low) / 255 * steps)

    @staticmethod
    def fields(grids: tuple[DepthGrid, ...]) -> dict[str, Any]:
        """Return ``depth`` of a reply whose eyes have these grids, of one shape; their ``data`` follow the object."""
        first = grids[0]
        return {
            "grid": (first.columns, first.rows),
            "inverse": [(float(f"{grid.low:.6g}"), float(f"{grid.high:.6g}")) for grid in grids],
        }


def grid_of(inverse: NDArray[np.floating]) -> DepthGrid:
    """Return the grid of inverse depths [rows, columns]; NaN, for the background, is filled from its neighbours."""
    filled = _filled(np.array(inverse, np.float64))
    low, high = float(filled.min()), float(filled.max())
    steps = np.rint((filled - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)
    return DepthGrid(filled.shape[1], filled.shape[0], low, high, steps.tobytes())


def read_grids(fields: Any, data: bytes) -> tuple[DepthGrid, ...]:
    """Return the grids of a reply's ``depth`` and the bytes behind it. Raises ValueError, KeyError or TypeError."""
    columns, rows = map(int, fields["grid"])
    ranges = [(float(low), float(high)) for low, high in fields["inverse"]]
    if not (2 <= columns <= _MAX_SIDE and 2 <= rows <= _MAX_SIDE and len(data) == len(ranges) * columns * rows):
        raise ValueError(f"{len(ranges)} grids of {columns} x {rows} in {len(data)} bytes")
    if not all(0 < low <= high < np.inf for low, high in ranges):
        raise ValueError("inverse depths need to be above 0")
    parts = (data[i * columns * rows : (i + 1) * columns * rows] for i in range(len(ranges)))
    return tuple(DepthGrid(columns, rows, *range_, part) for range_, part in zip(ranges, parts, strict=True))


def _filled(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fill NaN ring by ring with the mean of the known ones of four neighbours; with 0.5 where all are NaN."""
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


Box = tuple[int, int, int, int]
"""x, y, width, height in pixels."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """The JPEGs of one picture, in the order of its eyes, or one coded picture of a video."""

    pictures: list[bytes]
    boxes: list[Box] | None  # the box of each JPEG in its picture, if cropped
    ms: float  # wall time of the encoding
    alphas: list[bytes] | None = None  # grey JPEGs of the accumulated alpha, if requested
    video: dict[str, Any] | None = None  # "video" of the reply; ``pictures`` then has one coded picture of all eyes
