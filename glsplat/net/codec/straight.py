"""Straight (not premultiplied) colours, for pictures that are put over a background (docs/protocol.md).

Over black, the silhouette is the hardest edge of a picture, and JPEG's subsampled chroma smears it: the person gets a
dark rim, the black a coloured one. Straight colours continue beyond the silhouette to the end of its block, so the
colour has no edge there; alpha alone cuts it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_BLOCK = 16  # pixels of a 4:2:0 block of chroma; luma blocks are quarters of it
_AREA = _BLOCK * _BLOCK
_OPAQUE_FROM = 32  # alpha from which a pixel's own colour counts fully: below it has few bits

_ALPHA = np.arange(256, dtype=np.float32)
_OWN_SHARE = np.minimum(_ALPHA / _OPAQUE_FROM, 1)  # weight of a pixel's own colour, by alpha
# [256] factor that makes a premultiplied colour straight, times its weight
_STRAIGHT = (_OWN_SHARE * 255 / np.maximum(_ALPHA, 1)).astype(np.float32)
_MEAN_SHARE = (1 - _OWN_SHARE).astype(np.float32)
# [256, 4]: 1 where a pixel of a block is in that quarter
_HALF = np.kron(np.eye(2), np.ones((8, 1)))  # [16, 2]
_QUARTERS = np.einsum("ya,xb->yxab", _HALF, _HALF).reshape(_AREA, 4).astype(np.float32)


def straightened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a premultiplied ``image`` [H, W, 4] with straight colours and the same alpha.

    Pixels of little or no alpha get the mean colour of their 8x8 block, or of their 16x16 block if that is transparent.
    Transparent and opaque blocks stay as they are.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    out = np.zeros((rows * _BLOCK, columns * _BLOCK, 4), np.uint8)
    out[:height, :width] = image
    blocks = out.reshape(rows, _BLOCK, columns, _BLOCK, 4)
    lines = np.ascontiguousarray(out[..., 3]).reshape(rows, _BLOCK, -1)
    most, least = (of(axis=1).reshape(rows, columns, _BLOCK) for of in (lines.max, lines.min))
    row, column = np.nonzero((most.max(axis=2) > 0) & (least.min(axis=2) < 255))  # blocks on the silhouette
    pixels = blocks[row, :, column].reshape(-1, _AREA, 4).transpose(0, 2, 1).copy()  # [n, 4, 256]
    alpha, values = pixels[:, 3], pixels.astype(np.float32)
    sums = (values.reshape(-1, _AREA) @ _QUARTERS).reshape(-1, 4, 4)  # [n, channel, quarter]; one product, not n
    sums = np.where(sums[:, 3:] > 0, sums, sums.sum(axis=2, keepdims=True))
    means = (sums[:, :3] * (np.float32(255) / np.maximum(sums[:, 3:], 1))).reshape(-1, 4) @ _QUARTERS.T
    colour = values[:, :3] * _STRAIGHT[alpha][:, None]
    colour += means.reshape(-1, 3, _AREA) * _MEAN_SHARE[alpha][:, None]
    np.minimum(colour + 0.5, 255, out=colour)
    blocks[row, :, column, :, :3] = colour.astype(np.uint8).transpose(0, 2, 1).reshape(-1, _BLOCK, _BLOCK, 3)
    return out[:height, :width]
