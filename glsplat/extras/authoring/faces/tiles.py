"""Cover teeth with rows of splats: cells that ignore their shape would make chips of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.extras.authoring.body.enamel import (
    ARCH_XZ_M,
    MAX_CROWN_M,
    arch_angles,
    enamel,
    light_at,
    tooth_of_faces,
)

Indices = NDArray[np.intp]

# angles from the front up to which a tooth has this many tiles across and along it: molars are hardly visible
_TILE_COUNTS = ((np.radians(28), (4, 6)), (np.radians(47), (3, 4)), (np.inf, (2, 3)))
_SKIN_TINT = (1.0, 0.975, 0.93)  # light reflected by skin
_SIGMA_FACTOR = 0.62  # standard deviation of a tile, over the distance to the next
_SIDE_TURN_RAD = 0.5  # by which the sides of a tooth face aside
_MIN_VERTICES = 16  # of an erupted tooth
_TILE_OPACITY, _SEAM_OPACITY = 0.97, 0.5
_SEAM_SIGMAS_M, _SEAM_RGB = (0.0016, 0.00022), np.array((78, 52, 44)) / 255  # along and across, where teeth meet
_SEAM_PLACE = ((-0.97, -0.97), (0.3, 0.7))  # across and along a tooth, at the previous one


class ToothTiles(NamedTuple):
    """N tiles on the fronts of teeth; metres in the open body's space."""

    faces: Indices  # [N] of the mouth
    shares: F64  # [N, 3] barycentric
    along: F64  # [N, 3] from a tooth's tip
    facing: F64  # [N, 3]
    scales: F64  # [N, 2] along and across
    rgb: F64  # [N, 3] in [0, 1]
    opacity: F64  # [N]


def tile_teeth(
    mouth: F64, faces: NDArray[np.integer], tooth: NDArray[np.bool_], lower: NDArray[np.bool_]
) -> ToothTiles:
    """Return the tiles of ``mouth`` [M, 3]: its ``faces`` [F, 3] are ``tooth`` [F] or gum; ``lower`` [M] on the jaw."""
    every, turn = np.flatnonzero(tooth), arch_angles(mouth)
    label = tooth_of_faces(faces[tooth], len(mouth))
    found = []
    for one in np.unique(label):
        mine = every[label == one]
        used = np.unique(faces[mine])
        if len(used) >= _MIN_VERTICES:
            up = -1.0 if lower[used[0]] else 1.0
            found.append(_tile_tooth(mouth, faces, mine, turn, up))
    return ToothTiles(*(np.concatenate(each) for each in zip(*found, strict=True)))


def _tile_tooth(mouth: F64, faces: NDArray[np.integer], mine: Indices, turn: F64, up: float) -> ToothTiles:
    used, height = np.unique(faces[mine]), up * mouth[:, 1]
    low, high = turn[used].min(), turn[used].max()
    middle, half = (low + high) / 2, (high - low) / 2
    wide, tall = next(rows for until, rows in _TILE_COUNTS if abs(middle) < until)
    tip = height[used].min()
    crown = min(MAX_CROWN_M, height[used].max() - tip)
    grid = np.meshgrid((np.arange(wide) + 0.5) / wide * 2 - 1, (np.arange(tall) + 0.5) / tall)
    across, along = (np.append(each, seam) for each, seam in zip(grid, _SEAM_PLACE, strict=True))
    which, shares = _outermost(mouth, faces[mine], turn, height, middle + half * across, tip + crown * along)
    seam, far = np.arange(len(across)) >= wide * tall, float(np.hypot(*(mouth[used][:, [0, 2]] - ARCH_XZ_M).T).mean())
    sigmas = _SIGMA_FACTOR * crown / tall, _SIGMA_FACTOR * 2 * half * far / wide
    size = np.where(seam[:, None], _SEAM_SIGMAS_M, sigmas)
    rgb = np.where(seam[:, None], _SEAM_RGB, enamel(across[None], along[None])[0] * _SKIN_TINT / 255)
    rgb = rgb * light_at(np.array([middle]))
    side = middle + _SIDE_TURN_RAD * across
    facing = np.stack([np.sin(side), 0 * side, np.cos(side)], axis=1)
    opacity, seen = np.where(seam, _SEAM_OPACITY, _TILE_OPACITY), which >= 0
    ways = np.tile((0.0, up, 0.0), (len(across), 1))
    return ToothTiles(mine[which[seen]], *(each[seen] for each in (shares, ways, facing, size, rgb, opacity)))


def _outermost(
    mouth: F64, faces: NDArray[np.integer], turn: F64, height: F64, wide: F64, high: F64
) -> tuple[Indices, F64]:
    """Return the outermost triangle at angles ``wide`` [N] and heights ``high`` [N], -1 for none; and where [N, 3]."""
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
