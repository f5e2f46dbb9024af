"""Teeth and gums painted: each tooth by itself, darker where it meets the next, and towards the mouth's corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["CROWN", "MIDDLE", "enamel", "light_at", "painted", "teeth_of", "turn_of"]

F64 = NDArray[np.float64]
Indices = NDArray[np.intp]

CROWN = 0.0095
"""Metres of a tooth from its tip, at most; what is farther is root."""
MIDDLE = (0.0, 0.105)
"""Metres x and z, about which the arch of teeth is bent."""
_WIDE, _HIGH = 12, 24  # texels of a tooth
_TIP, _BODY, _NECK = (206, 209, 210), (221, 217, 209), (204, 192, 172)  # sRGB, of 255, in the middle of a mouth
_GUM = (150, 82, 80)
_GUMS = 4  # tiles that the gums have
_GAP, _ROUND = 0.45, 0.7  # how dark a tooth is where it meets the next; of its half width, from where on
_CORNER, _DARKEST = np.radians((12.0, 62.0)), 0.78  # from the front: where it begins to darken, and ends; how dark
_RED = 1.35  # power of that light in which green and blue have it


def painted(
    mouth: F64, faces: NDArray[np.integer], tooth: NDArray[np.bool_], lower: NDArray[np.bool_]
) -> tuple[F64, NDArray[np.uint8]]:
    """Coordinates [F, 3, 2] and texture of the ``mouth`` [M, 3], metres in the open body's space.

    ``faces`` [F, 3] are ``tooth`` [F] or gum; ``lower`` [M] on the jaw. Each tooth has a tile: across it, and up to
    its tip; gums have one of their own, which is wide as the arch is and darkens with it.
    """
    count, turn = len(mouth), turn_of(mouth)
    teeth, index = np.unique(teeth_of(faces[tooth], count), return_inverse=True)
    tiles = len(teeth) + _GUMS
    uv = np.zeros((len(faces), 3, 2))
    texture = np.full((_HIGH, tiles * _WIDE, 4), 255, np.uint8)
    across, along = np.meshgrid(np.linspace(-1, 1, _WIDE), np.linspace(1, 0, _HIGH))
    for number in range(len(teeth)):
        mine = np.flatnonzero(tooth)[index == number]
        used = np.unique(faces[mine])
        middle, half = (turn[used].max() + turn[used].min()) / 2, max(float(np.ptp(turn[used])) / 2, 1e-6)
        height = mouth[:, 1] if not lower[used[0]] else -mouth[:, 1]
        place = np.stack([(turn - middle) / half, (height - height[used].min()) / CROWN], axis=1).clip((-1, 0), 1)
        inset = 0.5 / _WIDE + (1 - 1 / _WIDE) * (place[:, 0] + 1) / 2
        uv[mine] = np.stack([(number + inset) / tiles, place[:, 1]], axis=1)[faces[mine]]
        tile = enamel(across, along) * light_at(np.array([middle]))
        texture[:, number * _WIDE : (number + 1) * _WIDE, :3] = np.rint(tile)
    gums = np.flatnonzero(~tooth)
    share = ((turn / np.pi + 0.5).clip(0, 1) * (_GUMS - 1 / _WIDE) + 0.5 / _WIDE + len(teeth)) / tiles
    uv[gums] = np.stack([share, np.full(count, 0.5)], axis=1)[faces[gums]]
    turns = (np.linspace(0, 1, _GUMS * _WIDE) - 0.5) * np.pi
    texture[:, len(teeth) * _WIDE :, :3] = np.rint(np.array(_GUM) * light_at(turns))
    return uv, texture


def teeth_of(faces: NDArray[np.integer], count: int) -> Indices:
    """[F] which tooth each of the ``faces`` [F, 3] of ``count`` vertices is of."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    _, label = connected_components(coo_array((np.ones(len(ends)), ends.T), (count, count)), directed=False)
    return np.asarray(label[faces[:, 0]])


def turn_of(mouth: F64) -> F64:
    """[M] radians to the person's left about the arch's middle."""
    return np.asarray(np.arctan2(mouth[:, 0] - MIDDLE[0], mouth[:, 2] - MIDDLE[1]))


def enamel(across: F64, along: F64) -> F64:
    """[H, W, 3] of a tooth, ``along`` from its tip to its neck."""
    tip, body, neck = (np.array(colour, np.float64) for colour in (_TIP, _BODY, _NECK))
    edge, root = (1 - along / 0.3).clip(0, 1)[..., None], ((along - 0.55) / 0.45).clip(0, 1)[..., None]
    gap = _GAP * ((np.abs(across) - _ROUND) / (1 - _ROUND)).clip(0, 1)[..., None] ** 1.5
    return np.asarray((body + edge * (tip - body) + root * (neck - body)) * (1 - gap))


def light_at(turn: F64) -> F64:
    """[N, 3] how much light there is, by the angle [N] about the arch's middle: red, as flesh is around it."""
    low, high = _CORNER
    part = ((np.abs(turn) - low) / (high - low)).clip(0, 1)
    light = 1 - _DARKEST * part * part * (3 - 2 * part)
    return np.asarray(light[:, None] ** np.array((1.0, _RED, _RED)))
