"""Paint teeth and gums, and cover teeth with rows of splats.

A tooth has one tile of texture, darker at its neighbours and towards the mouth's corners. Cells of splats that ignore
the shape of teeth would make chips of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from glsplat.arrays import F64

Indices = NDArray[np.intp]
MAX_CROWN_M = 0.0095
"""Length of a tooth from its tip; the rest is root."""
ARCH_XZ_M = (0.0, 0.105)
"""x and z of the centre of the arch of teeth."""
_TOOTH_WIDTH_PX, _TOOTH_HEIGHT_PX = 12, 24  # texels
_TIP_RGB, _BODY_RGB, _NECK_RGB = (206, 209, 210), (221, 217, 209), (204, 192, 172)  # sRGB of 255, front teeth
_GUM_RGB = (150, 82, 80)
_GUM_TILES = 4
_GAP_DARKENING, _GAP_START_FRACTION = 0.45, 0.7  # at the edge of a tooth, and the half width where it begins
_DARKENING_RAD, _CORNER_DARKENING = np.radians((12.0, 62.0)), 0.78  # start and end from the front, and its amount
_GREEN_BLUE_POWER = 1.35  # of the light: flesh around the teeth makes it red
# angles from the front up to which a tooth has this many tiles across and along it: molars are hardly visible
_TILE_COUNTS = ((np.radians(28), (4, 6)), (np.radians(47), (3, 4)), (np.inf, (2, 3)))
_SKIN_TINT = (1.0, 0.975, 0.93)  # light reflected by skin
_SIGMA_FACTOR = 0.62  # standard deviation of a tile, over the distance to the next
_SIDE_TURN_RAD = 0.5  # by which the sides of a tooth face aside
_MIN_VERTICES = 16  # of an erupted tooth
_TILE_OPACITY, _SEAM_OPACITY = 0.97, 0.5
_SEAM_SIGMAS_M, _SEAM_RGB = (0.0016, 0.00022), np.array((78, 52, 44)) / 255  # along and across, where teeth meet
_SEAM_PLACE = ((-0.97, -0.97), (0.3, 0.7))  # across and along a tooth, at the previous one


def paint_teeth(
    mouth: F64, faces: NDArray[np.integer], tooth: NDArray[np.bool_], lower: NDArray[np.bool_]
) -> tuple[F64, NDArray[np.uint8]]:
    """Return texture coordinates [F, 3, 2] and the texture of the ``mouth`` [M, 3], metres in the open body's space.

    ``tooth`` [F] marks the ``faces`` [F, 3] of teeth, the others are gums; ``lower`` [M] marks the jaw's vertices.
    Each tooth has a tile, from edge to edge and from neck to tip. The gums' tile spans the arch and darkens with it.
    """
    count, turn = len(mouth), arch_angles(mouth)
    teeth, index = np.unique(tooth_of_faces(faces[tooth], count), return_inverse=True)
    tiles = len(teeth) + _GUM_TILES
    uv = np.zeros((len(faces), 3, 2))
    texture = np.full((_TOOTH_HEIGHT_PX, tiles * _TOOTH_WIDTH_PX, 4), 255, np.uint8)
    across, along = np.meshgrid(np.linspace(-1, 1, _TOOTH_WIDTH_PX), np.linspace(1, 0, _TOOTH_HEIGHT_PX))
    for number in range(len(teeth)):
        rows = np.flatnonzero(tooth)[index == number]
        used = np.unique(faces[rows])
        middle, half = (turn[used].max() + turn[used].min()) / 2, max(float(np.ptp(turn[used])) / 2, 1e-6)
        height = mouth[:, 1] if not lower[used[0]] else -mouth[:, 1]
        place = np.stack([(turn - middle) / half, (height - height[used].min()) / MAX_CROWN_M], axis=1).clip((-1, 0), 1)
        inset = 0.5 / _TOOTH_WIDTH_PX + (1 - 1 / _TOOTH_WIDTH_PX) * (place[:, 0] + 1) / 2
        uv[rows] = np.stack([(number + inset) / tiles, place[:, 1]], axis=1)[faces[rows]]
        tile = enamel(across, along) * light_at(np.array([middle]))
        texture[:, number * _TOOTH_WIDTH_PX : (number + 1) * _TOOTH_WIDTH_PX, :3] = np.rint(tile)
    gums = np.flatnonzero(~tooth)
    half_texel = 0.5 / _TOOTH_WIDTH_PX  # so that tiles do not mix
    share = ((turn / np.pi + 0.5).clip(0, 1) * (_GUM_TILES - 2 * half_texel) + half_texel + len(teeth)) / tiles
    uv[gums] = np.stack([share, np.full(count, 0.5)], axis=1)[faces[gums]]
    turns = (np.linspace(0, 1, _GUM_TILES * _TOOTH_WIDTH_PX) - 0.5) * np.pi
    texture[:, len(teeth) * _TOOTH_WIDTH_PX :, :3] = np.rint(np.array(_GUM_RGB) * light_at(turns))
    return uv, texture


def tooth_of_faces(faces: NDArray[np.integer], count: int) -> Indices:
    """Return a label of its tooth [F] for each of the ``faces`` [F, 3] of ``count`` vertices."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    _, label = connected_components(coo_array((np.ones(len(ends)), ends.T), (count, count)), directed=False)
    return np.asarray(label[faces[:, 0]])


def arch_angles(mouth: F64) -> F64:
    """Return the angles [M] in radians about the arch's centre, positive to the person's left."""
    return np.asarray(np.arctan2(mouth[:, 0] - ARCH_XZ_M[0], mouth[:, 2] - ARCH_XZ_M[1]))


def enamel(across: F64, along: F64) -> F64:
    """Return the sRGB colours [H, W, 3] of a tooth, ``across`` it (-1 to 1) and ``along`` it (0 tip to 1 neck)."""
    tip, body, neck = (np.array(colour, np.float64) for colour in (_TIP_RGB, _BODY_RGB, _NECK_RGB))
    edge, root = (1 - along / 0.3).clip(0, 1)[..., None], ((along - 0.55) / 0.45).clip(0, 1)[..., None]
    near_edge = (np.abs(across) - _GAP_START_FRACTION) / (1 - _GAP_START_FRACTION)
    gap = _GAP_DARKENING * near_edge.clip(0, 1)[..., None] ** 1.5
    return np.asarray((body + edge * (tip - body) + root * (neck - body)) * (1 - gap))


def light_at(turn: F64) -> F64:
    """Return the RGB factors [N, 3] of the light at angles [N] in radians about the arch's centre."""
    low, high = _DARKENING_RAD
    part = ((np.abs(turn) - low) / (high - low)).clip(0, 1)
    light = 1 - _CORNER_DARKENING * part * part * (3 - 2 * part)
    return np.asarray(light[:, None] ** np.array((1.0, _GREEN_BLUE_POWER, _GREEN_BLUE_POWER)))


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
