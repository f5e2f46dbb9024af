"""Bake vertex colours into a texture: a small square of texels for each triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.meshes import MeshPart
from glsplat.pictures import to_linear, to_srgb

_LEAST, _UNEVEN, _MOST = 3, 9, 24  # texels a side of a square: fewest, for uneven colours, most
_EVEN = 0.15  # range of factors in a triangle below which the fewest suffice
_SIDE = 8192  # texels a side of the texture


def painted(
    faces: NDArray[np.int64],  # [F, 3]
    colours: F64,  # [V, 4] linear factors
    uv: F64,  # [F, 3, 2] of the texture, v up
    texture: NDArray[np.uint8],  # [H, W, 4]
) -> tuple[F64, NDArray[np.uint8]]:
    """Return coordinates [F, 3, 2] into a new texture: ``texture`` times the linearly interpolated colours."""
    count = len(faces)
    side = _texels(uv, texture, colours[faces])
    across = int(np.ceil(np.sqrt(count)))
    down = -(-count // across)
    steps = np.arange(side) / (side - 1)
    b, c = np.meshgrid(steps, steps)  # of the second and the third corner; extrapolated beyond the triangle
    weights = np.stack([1 - b - c, b, c], axis=-1)  # [S, S, 3]
    out = np.empty((down, side, across, side, 4), np.uint8)
    part = MeshPart("", faces.astype(np.int32), uv, texture)
    plain = bool((texture == texture[:1, :1]).all())
    for row in range(down):
        mine = slice(row * across, min((row + 1) * across, count))
        factor = np.clip(np.einsum("ijk,fkc->fijc", weights, colours[faces[mine]]), 0, 1)
        seen = texture[0, 0] / 255.0 if plain else part.sample(np.einsum("ijk,fkc->fijc", weights, uv[mine]))
        seen = np.broadcast_to(seen, factor.shape)
        values = np.concatenate(
            [to_srgb(to_linear(seen[..., :3]) * factor[..., :3]), seen[..., 3:] * factor[..., 3:]], axis=-1
        )
        out[row] = 255
        out[row, :, : len(values)] = np.rint(values * 255).astype(np.uint8).transpose(1, 0, 2, 3)
    column, line = np.arange(count) % across, np.arange(count) // across
    corner = np.stack([column, line], axis=1)[:, None] * side + 0.5 + np.array([[0, 0], [1, 0], [0, 1]]) * (side - 1)
    corner = corner / (across * side, down * side)
    corner[..., 1] = 1 - corner[..., 1]
    return corner, out.reshape(down * side, across * side, 4)


def _texels(uv: F64, texture: NDArray[np.uint8], corners: F64) -> int:
    """Return texels a side of a square: about the triangles' present resolution, and enough for their colours.

    Colours between texels are mixed in sRGB, not in linear light.
    """
    spread = float(np.percentile(np.ptp(corners, axis=1).max(axis=1), 95))
    least = _LEAST if spread < _EVEN else _UNEVEN
    count = len(corners)
    size = np.array(texture.shape[1::-1])
    edges = np.linalg.norm((uv - np.roll(uv, 1, axis=1)) * size, axis=-1)
    wanted = int(np.clip(np.ceil(np.percentile(edges, 90)) + 1, least, _MOST)) if texture.shape[0] > 4 else least
    return max(_LEAST, min(wanted, _SIDE // max(int(np.ceil(np.sqrt(count))), 1)))
