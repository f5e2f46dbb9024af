"""Teeth in rows of splats: cells that know nothing of teeth make chips of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.body.enamel import (
    ARCH_XZ_M,
    MAX_CROWN_M,
    arch_angles,
    enamel,
    light_at,
    tooth_of_faces,
)

__all__ = ["Tiles", "tiled"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

# radians from the front up to which a tooth has so many tiles across and along it: molars are hardly seen
_ROWS = ((np.radians(28), (4, 6)), (np.radians(47), (3, 4)), (np.inf, (2, 3)))
_WARM = (1.0, 0.975, 0.93)  # beside skin: what is lit by it
_TIGHT = 0.62  # standard deviations of a tile, of the distance to the next
_BULGE = 0.5  # radians by which the sides of a tooth look aside
_FEWEST = 16  # vertices of a tooth that has come
_SOLID, _SEAM_SOLID = 0.97, 0.5
_SEAM, _SEAM_RGB = (0.0016, 0.00022), np.array((78, 52, 44)) / 255  # metres along and across it, where teeth meet
_SEAMS = ((-0.97, -0.97), (0.3, 0.7))  # across and along a tooth, the seam to the one before


class Tiles(NamedTuple):
    """N places on the fronts of teeth; metres in the open body's space."""

    faces: Indices  # [N] of the mouth's
    shares: F64  # [N, 3] of their corners
    along: F64  # [N, 3] from a tooth's tip
    facing: F64  # [N, 3]
    scales: F64  # [N, 2] along and across
    rgb: F64  # [N, 3] in [0, 1]
    solid: F64  # [N]


def tiled(mouth: F64, faces: NDArray[np.integer], tooth: NDArray[np.bool_], lower: NDArray[np.bool_]) -> Tiles:
    """Of the ``mouth`` [M, 3], whose ``faces`` [F, 3] are ``tooth`` [F] or gum; ``lower`` [M] on the jaw."""
    every, turn = np.flatnonzero(tooth), arch_angles(mouth)
    label = tooth_of_faces(faces[tooth], len(mouth))
    found = []
    for one in np.unique(label):
        mine = every[label == one]
        used = np.unique(faces[mine])
        if len(used) >= _FEWEST:
            up = -1.0 if lower[used[0]] else 1.0
            found.append(_of_tooth(mouth, faces, mine, turn, up))
    return Tiles(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _of_tooth(mouth: F64, faces: NDArray[np.integer], mine: Indices, turn: F64, up: float) -> Tiles:
    used, height = np.unique(faces[mine]), up * mouth[:, 1]
    low, high = turn[used].min(), turn[used].max()
    middle, half = (low + high) / 2, (high - low) / 2
    wide, tall = next(rows for until, rows in _ROWS if abs(middle) < until)
    tip = height[used].min()
    crown = min(MAX_CROWN_M, height[used].max() - tip)
    grid = np.meshgrid((np.arange(wide) + 0.5) / wide * 2 - 1, (np.arange(tall) + 0.5) / tall)
    across, along = (np.append(each, seam) for each, seam in zip(grid, _SEAMS, strict=True))
    which, shares = _foremost(mouth, faces[mine], turn, height, middle + half * across, tip + crown * along)
    seam, far = (
        np.arange(len(across)) >= wide * tall,
        float(np.hypot(*(mouth[used][:, [0, 2]] - ARCH_XZ_M).T).mean()),
    )
    size = np.where(seam[:, None], _SEAM, (_TIGHT * crown / tall, _TIGHT * 2 * half * far / wide))
    rgb = np.where(seam[:, None], _SEAM_RGB, enamel(across[None], along[None])[0] * _WARM / 255) * light_at(
        np.array([middle])
    )
    side = middle + _BULGE * across
    facing = np.stack([np.sin(side), 0 * side, np.cos(side)], axis=1)
    solid, seen = np.where(seam, _SEAM_SOLID, _SOLID), which >= 0
    ways = np.tile((0.0, up, 0.0), (len(across), 1))
    return Tiles(mine[which[seen]], *(each[seen] for each in (shares, ways, facing, size, rgb, solid)))


def _foremost(
    mouth: F64, faces: NDArray[np.integer], turn: F64, height: F64, wide: F64, high: F64
) -> tuple[Indices, F64]:
    """The outermost of triangles [F, 3] at angles ``wide`` [N] and heights ``high`` [N], -1 for none; where [N, 3]."""
    flat = np.stack([turn, height], axis=1)[faces]
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    to = np.stack([wide, high], axis=1)[:, None] - flat[:, 0]
    size = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    size = np.where(np.abs(size) < 1e-12, np.inf, size)
    u = (to[..., 0] * second[:, 1] - to[..., 1] * second[:, 0]) / size
    v = (first[:, 0] * to[..., 1] - first[:, 1] * to[..., 0]) / size
    shares = np.stack([1 - u - v, u, v], axis=2)
    far = np.hypot(*(mouth[:, [0, 2]] - ARCH_XZ_M).T)[faces]
    there = np.where((shares >= -1e-9).all(axis=2) & np.isfinite(size), (shares * far).sum(axis=2), -np.inf)
    best, rows = there.argmax(axis=1), np.arange(len(wide))
    return np.where(np.isfinite(there[rows, best]), best, -1), shares[rows, best]
