"""Draw splats on the CPU and backpropagate to them; the same bytes with any number of threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.extras.authoring.geometry.posed import PosedSplats
from glsplat.extras.authoring.optimize import kernels
from glsplat.extras.authoring.optimize.kernels import GRADIENTS, RECORD, SUMS, TILE
from glsplat.extras.authoring.optimize.view_consistency import Shares, list_shares
from glsplat.io.cores import cores

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_PARTS = 8  # of the splats and of the tiles, shared out among threads


class Gradients(NamedTuple):
    """Derivatives of the loss; zero for hidden splats. Views of one array that the next call overwrites."""

    means: F64  # [N, 3]
    log_scales: F64  # [N, 3]
    turns: F64  # [N, 3] by a small rotation about the splat's own axes
    exponents: F64  # [N] by the logarithm of the opacity
    rgb: F64  # [N, 3]
    weight: F64  # [N] sum over pixels of alpha times transmittance
    error: F64  # [N] sum over pixels of alpha times transmittance times error


class Rasterizer:
    """A rasterizer for up to ``count`` splats. Call ``draw``, then ``backward``; repeat with other pictures.

    ``threads``: by default the cores this process may use; they end with the rasterizer. A pixel is finished when less
    than ``min_transmittance`` passes.
    """

    def __init__(self, count: int, threads: int | None = None, min_transmittance: float = 1e-4) -> None:
        self._floor = np.float32(min_transmittance)
        threads = threads or cores()
        self._pool = ThreadPoolExecutor(threads, "glsplat-fit") if threads > 1 else None  # else on the caller's own
        self._record, self._box = np.zeros((count, RECORD), np.float32), np.zeros((count, 4), np.int32)
        self._to_pixels, self._axes = np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
        self._slope, self._totals = np.zeros((count, 3)), np.zeros((count, SUMS))
        self.out: F64 = np.zeros((count, GRADIENTS))  # of the last backward(), a row a splat
        self._sums = np.zeros((0, SUMS), np.float32)

    def place(self, splats: PosedSplats, camera: Camera, antialias: bool) -> None:
        """Project the splats, at most ``count``, into the camera's picture; ``shares`` needs this."""
        width, height, count = camera.width, camera.height, len(splats.means)
        self._ranges = list(pairwise(np.linspace(0, count, _PARTS + 1).astype(int).tolist()))
        K = camera.K
        self._scales, self._size = splats.scales, (height, width)
        view = np.ascontiguousarray(camera.viewmat, np.float64)
        lens = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
        near, size, placed = float(camera.near), (width, height), splats[:5]
        written = self._record, self._box, self._to_pixels, self._axes, self._slope
        self._each(
            self._ranges,
            lambda part: kernels.project(part[0], part[1], placed, view, lens, size, near, antialias, *written),
        )
        shown = np.flatnonzero(self._record[:count, 5] > 0)
        order = shown[np.argsort(self._record[shown, 7], kind="stable")]
        tile_columns, tile_rows = -(-width // TILE), -(-height // TILE)
        self._order = order
        start, splat = kernels.list_entries(order, self._box, tile_columns, tile_rows)
        each = np.diff(start)
        tiles = np.argsort(-each, kind="stable")
        tiles = tiles[each[tiles] > 0]
        self._work = [np.ascontiguousarray(tiles[k::_PARTS]) for k in range(_PARTS)]
        self._entries = tile_columns, start, splat, self._record, self._box

    def draw(self, splats: PosedSplats, camera: Camera, antialias: bool) -> F32:
        """Return the premultiplied picture, RGBA [H, W, 4], over nothing."""
        self.place(splats, camera, antialias)
        self._picture, passes = np.zeros((*self._size, 4), np.float32), np.ones(self._size, np.float32)
        self._each(self._work, lambda tiles: kernels.draw(tiles, *self._entries, self._picture, passes, self._floor))
        return self._picture

    def backward(self, slope: F32, error: F32) -> Gradients:
        """Return the gradients for the slope [H, W, 4] of a loss by the last picture; ``error`` [H, W] is summed."""
        _, _, splat, _, _ = self._entries
        if len(self._sums) < len(splat):
            self._sums = np.zeros((len(splat) * 5 // 4, SUMS), np.float32)
        passes = np.ones(slope.shape[:2], np.float32)
        behind = np.einsum("hwc,hwc->hw", slope, self._picture)
        self._each(
            self._work,
            lambda tiles: kernels.backward(
                tiles, *self._entries, slope, error, passes, self._floor, behind, self._sums
            ),
        )
        kernels.add_up(splat, self._sums, self._totals)
        shapes = self._record, self._to_pixels, self._axes, self._slope, self._scales
        self._each(self._ranges, lambda part: kernels.gather(part[0], part[1], self._totals, *shapes, self.out))
        out = self.out
        return Gradients(out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9], out[:, 10:13], out[:, 13], out[:, 14])

    def shares(self) -> Shares:
        """Return the shares of pixels of the splats of the last ``place``; entries without pixels are left out."""
        tile_columns, start, splat, record, box = self._entries
        room = int((box[self._order, 1::2] - box[self._order, ::2] + 1).prod(axis=1, dtype=np.int64).sum())
        first, pixel, weight = np.empty(len(splat) + 1, np.int64), np.empty(room, np.int32), np.empty(room, np.float32)
        list_shares(tile_columns, start, splat, record, box, self._size, self._floor, first, pixel, weight)
        nonempty, count = np.diff(first) > 0, first[-1]
        starts = np.append(first[:-1][nonempty], count)
        return Shares(splat[nonempty], starts, pixel[:count].copy(), weight[:count].copy())

    def weights(self) -> F64:
        """Return each splat's share of the last picture [N], in pixels."""
        nothing = np.zeros_like(self._picture)
        return self.backward(nothing, nothing[:, :, 0]).weight.copy()

    def _each(self, parts: list[Any], work: Callable[[Any], None]) -> None:
        for _ in map(work, parts) if self._pool is None else self._pool.map(work, parts):  # re-raises a thread's error
            pass
