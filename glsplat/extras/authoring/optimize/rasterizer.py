"""Draws splats on the CPU and takes a slope by the picture back to them; the same bytes with any number of threads."""

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
from glsplat.extras.authoring.optimize.view_consistency import Shares, shared
from glsplat.io.cores import cores

__all__ = ["Gradients", "Rasterizer"]

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_PARTS = 8  # of the splats and of the tiles that threads take one after the other


class Gradients(NamedTuple):
    """Derivatives of the loss; zero where nothing is seen. Views of one array that the next call writes over."""

    means: F64  # [N, 3]
    log_scales: F64  # [N, 3]
    turns: F64  # [N, 3] by a small rotation about the splat's own axes
    exponents: F64  # [N] by the logarithm of the opacity
    rgb: F64  # [N, 3]
    weight: F64  # [N] how much of the picture a splat makes, in pixels
    error: F64  # [N] the same times the error there


class Rasterizer:
    """Memory for ``count`` splats. ``draw`` first, then ``backward``, as often as one likes.

    ``threads``: by default as many as cores this process may use. They end with the rasterizer. ``least``: nothing is
    drawn where less than that passes all in front.
    """

    def __init__(self, count: int, threads: int | None = None, least: float = 1e-4) -> None:
        self._least = np.float32(least)
        threads = threads or cores()
        self._pool = ThreadPoolExecutor(threads, "glsplat-fit") if threads > 1 else None  # else on the caller's own
        self._record, self._box = np.zeros((count, RECORD), np.float32), np.zeros((count, 4), np.int32)
        self._to_pixels, self._axes = np.zeros((count, 2, 3)), np.zeros((count, 2, 3))
        self._slope, self._totals = np.zeros((count, 3)), np.zeros((count, SUMS))
        self.out: F64 = np.zeros((count, GRADIENTS))  # of the last backward(), a row a splat
        self._sums = np.zeros((0, SUMS), np.float32)

    def place(self, splats: PosedSplats, camera: Camera, antialias: bool) -> None:
        """Find where the splats, ``count`` or fewer, are in the camera's picture, before ``shares``."""
        width, height, many = camera.width, camera.height, len(splats.means)
        self._ranges = list(pairwise(np.linspace(0, many, _PARTS + 1).astype(int).tolist()))
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
        shown = np.flatnonzero(self._record[:many, 5] > 0)
        order = shown[np.argsort(self._record[shown, 7], kind="stable")]
        across, down = -(-width // TILE), -(-height // TILE)
        self._order = order
        start, splat = kernels.list_entries(order, self._box, across, down)
        each = np.diff(start)
        tiles = np.argsort(-each, kind="stable")
        tiles = tiles[each[tiles] > 0]
        self._work = [np.ascontiguousarray(tiles[k::_PARTS]) for k in range(_PARTS)]
        self._entries = across, start, splat, self._record, self._box

    def draw(self, splats: PosedSplats, camera: Camera, antialias: bool) -> F32:
        """Premultiplied RGBA [H, W, 4] over nothing."""
        self.place(splats, camera, antialias)
        self._picture, passes = np.zeros((*self._size, 4), np.float32), np.ones(self._size, np.float32)
        self._each(self._work, lambda tiles: kernels.draw(tiles, *self._entries, self._picture, passes, self._least))
        return self._picture

    def backward(self, slope: F32, error: F32) -> Gradients:
        """From the slope [H, W, 4] of a loss by the last picture, and its error [H, W], to the splats."""
        _, _, splat, _, _ = self._entries
        if len(self._sums) < len(splat):
            self._sums = np.zeros((len(splat) * 5 // 4, SUMS), np.float32)
        passes = np.ones(slope.shape[:2], np.float32)
        behind = np.einsum("hwc,hwc->hw", slope, self._picture)
        self._each(
            self._work,
            lambda tiles: kernels.backward(
                tiles, *self._entries, slope, error, passes, self._least, behind, self._sums
            ),
        )
        kernels.add_up(splat, self._sums, self._totals)
        shapes = self._record, self._to_pixels, self._axes, self._slope, self._scales
        self._each(self._ranges, lambda part: kernels.gather(part[0], part[1], self._totals, *shapes, self.out))
        out = self.out
        return Gradients(out[:, :3], out[:, 3:6], out[:, 6:9], out[:, 9], out[:, 10:13], out[:, 13], out[:, 14])

    def shares(self) -> Shares:
        """How much of which pixel the splats that ``place`` was called with make; of those that make some."""
        across, start, splat, record, box = self._entries
        room = int((box[self._order, 1::2] - box[self._order, ::2] + 1).prod(axis=1, dtype=np.int64).sum())
        first, pixel, weight = np.empty(len(splat) + 1, np.int64), np.empty(room, np.int32), np.empty(room, np.float32)
        shared(across, start, splat, record, box, self._size, self._least, first, pixel, weight)
        some, count = np.diff(first) > 0, first[-1]
        return Shares(splat[some], np.append(first[:-1][some], count), pixel[:count].copy(), weight[:count].copy())

    def weights(self) -> F64:
        """[N] how much of the last picture each splat makes, in pixels."""
        nothing = np.zeros_like(self._picture)
        return self.backward(nothing, nothing[:, :, 0]).weight.copy()

    def _each(self, parts: list[Any], work: Callable[[Any], None]) -> None:
        for _ in map(work, parts) if self._pool is None else self._pool.map(work, parts):  # raises what a thread raised
            pass
