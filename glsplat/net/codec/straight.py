"""Colour as it is before it is multiplied by alpha, for pictures that are put over something (docs/protocol.md).

Over black, a silhouette is the hardest edge of a picture, and a codec that halves chroma and drops high frequencies
smears it: the person gets a dark rim, the black around it a coloured one. Here the colour goes on beyond the
silhouette, to the end of its block, so that there is no edge in it; alpha alone cuts it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["straightened"]

_BLOCK = 16  # pixels of a 4:2:0 block, in which chroma is coded; luma in quarters of it
_AREA = _BLOCK * _BLOCK
_OPAQUE_FROM = 32  # alpha from which a pixel's own colour counts fully: below, it is made of few bits

_ALPHA = np.arange(256, dtype=np.float32)
_OWN_SHARE = np.minimum(_ALPHA / _OPAQUE_FROM, 1)  # by alpha: how far a pixel's own colour counts
_STRAIGHT = (_OWN_SHARE * 255 / np.maximum(_ALPHA, 1)).astype(
    np.float32
)  # ... and what its premultiplied one is to be times
_MEAN_SHARE = (1 - _OWN_SHARE).astype(np.float32)
# [256, 4]: which quarter of a block each of its pixels is in
_HALF = np.kron(np.eye(2), np.ones((8, 1)))  # [16, 2]
_QUARTERS = np.einsum("ya,xb->yxab", _HALF, _HALF).reshape(_AREA, 4).astype(np.float32)


def straightened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """``image`` [H, W, 4], premultiplied, with straight colours; alpha is as it was.

    Pixels of little or no alpha get the mean colour of their 8x8 block, or of their 16x16 block where that has none.
    Blocks without any alpha stay black, blocks that are opaque as they are.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    out = np.zeros((rows * _BLOCK, columns * _BLOCK, 4), np.uint8)
    out[:height, :width] = image
    blocks = out.reshape(rows, _BLOCK, columns, _BLOCK, 4)
    lines = np.ascontiguousarray(out[..., 3]).reshape(rows, _BLOCK, -1)
    most, least = (of(axis=1).reshape(rows, columns, _BLOCK) for of in (lines.max, lines.min))
    row, column = np.nonzero((most.max(axis=2) > 0) & (least.min(axis=2) < 255))  # the silhouette runs through these
    pixels = blocks[row, :, column].reshape(-1, _AREA, 4).transpose(0, 2, 1).copy()  # [n, 4, 256]
    alpha, values = pixels[:, 3], pixels.astype(np.float32)
    sums = (values.reshape(-1, _AREA) @ _QUARTERS).reshape(-1, 4, 4)  # channel, quarter; one product, not n
    sums = np.where(sums[:, 3:] > 0, sums, sums.sum(axis=2, keepdims=True))
    means = (sums[:, :3] * (np.float32(255) / np.maximum(sums[:, 3:], 1))).reshape(-1, 4) @ _QUARTERS.T
    colour = values[:, :3] * _STRAIGHT[alpha][:, None]
    colour += means.reshape(-1, 3, _AREA) * _MEAN_SHARE[alpha][:, None]
    np.minimum(colour + 0.5, 255, out=colour)
    blocks[row, :, column, :, :3] = colour.astype(np.uint8).transpose(0, 2, 1).reshape(-1, _BLOCK, _BLOCK, 3)
    return out[:height, :width]
