"""Find the point of the surface that each texel of a texture shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_MIN_AREA_TEXELS = 1e-9  # of a triangle that has texels


@dataclass(frozen=True, slots=True, eq=False)
class Texels:
    """The M texels whose centres lie in a triangle, each once."""

    index: NDArray[np.intp]  # [M] row x width + column; row 0 is at v = 1
    face: NDArray[np.intp]  # [M]
    weights: F64  # [M, 3] barycentric


def texels_of(uv: F64, width: int, height: int) -> Texels:
    """Return the texels of triangles ``uv`` [F, 3, 2] (v up, in [0, 1]); where two overlap, the later one wins."""
    x, y = uv[..., 0] * width - 0.5, (1 - uv[..., 1]) * height - 0.5  # centres are whole numbers
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    flat = np.abs(area) < _MIN_AREA_TEXELS
    inverse = (1 / np.where(flat, np.inf, area))[:, None]
    # barycentric coordinates are right * column + down * row + start; [F, 3] each
    ahead, behind = np.roll(np.arange(3), -1), np.roll(np.arange(3), 1)
    right, down = (y[:, ahead] - y[:, behind]) * inverse, (x[:, behind] - x[:, ahead]) * inverse
    start = (x[:, ahead] * y[:, behind] - x[:, behind] * y[:, ahead]) * inverse

    first = np.ceil(y.min(axis=1)).clip(0).astype(np.intp)
    rows = (np.floor(y.max(axis=1)).clip(max=height - 1).astype(np.intp) - first + 1).clip(0)
    line_face, below = _runs(rows)
    row = first[line_face] + below
    level = down[line_face] * row[:, None] + start[line_face]
    slope = right[line_face]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -level / slope
    left = np.where(slope > 0, crossing, np.where((slope == 0) & (level < 0), np.inf, -np.inf)).max(axis=1)
    end = np.where(slope < 0, crossing, np.inf).min(axis=1)
    left, end = np.ceil(left.clip(0, width)), np.floor(end.clip(-1, width - 1))
    line, along = _runs((end - left + 1).clip(0).astype(np.intp) * ~flat[line_face])
    column = left.astype(np.intp)[line] + along
    index = row[line] * width + column

    owner = np.full(width * height, -1, np.intp)
    owner[index] = np.arange(len(index))  # edges that two triangles share
    last = owner[owner >= 0]
    weights = (level[line[last]] + slope[line[last]] * column[last, None]).clip(0, 1)
    return Texels(index[last], line_face[line[last]], weights / weights.sum(axis=1, keepdims=True))


def _runs(counts: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the run of each element of all runs, and its place in the run from 0."""
    which = np.repeat(np.arange(len(counts)), counts)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
