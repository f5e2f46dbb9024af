"""Paint teeth and gums: one tile for each tooth, darker at its neighbours and towards the mouth's corners."""

from __future__ import annotations

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
