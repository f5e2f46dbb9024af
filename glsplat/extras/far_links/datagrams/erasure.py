"""Erasure code: any parity pieces replace as many lost pieces.

A systematic Reed-Solomon code over GF(256) with a Cauchy matrix (Bloemer et al.: An XOR-Based Erasure-Resilient Coding
Scheme, ICSI TR-95-048, 1995): every square part of such a matrix has an inverse. Twin: web/stream/pieces.js.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

MOST = 255
"""Most pieces and parity pieces of one code together."""
_POLYNOMIAL = 0x11D  # x^8 + x^4 + x^3 + x^2 + 1, of which 2 is a generator


def _tables() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return products [256, 256] and inverses [256] in GF(256)."""
    power, log = np.zeros(510, np.uint8), np.zeros(256, np.int64)
    value = 1
    for exponent in range(255):
        power[exponent] = power[exponent + 255] = value
        log[value] = exponent
        value = value << 1 ^ (_POLYNOMIAL if value & 0x80 else 0)
    product = power[log[:, None] + log[None, :]]
    product[0], product[:, 0] = 0, 0
    inverse = power[(255 - log) % 255]
    inverse[0] = 0
    return product, inverse


_PRODUCT, _INVERSE = _tables()
_TIMES = [row.tobytes() for row in _PRODUCT]  # for bytes.translate, ten times as fast as NumPy's look-up


def _factors(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return factors [R, C] of ``columns`` (pieces) in ``rows`` (parity): 1 / (x + y), x = 255 - row, y = column."""
    return _INVERSE[(255 - rows)[:, None] ^ columns[None, :]]


def parity_of(pieces: NDArray[np.uint8], count: int) -> NDArray[np.uint8]:
    """Return parity pieces [count, N] of ``pieces`` [K, N]; K + count is at most ``MOST``."""
    assert len(pieces) + count <= MOST
    out = np.empty((count, pieces.shape[1]), np.uint8)
    factors = _factors(np.arange(count), np.arange(len(pieces)))
    texts = [piece.tobytes() for piece in pieces]
    for row in range(count):
        out[row] = _summed(texts, factors[row])
    return out


def _summed(pieces: list[bytes], factors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the sum [N] of pieces times their factors."""
    out = np.zeros(len(pieces[0]), np.uint8)
    for piece, factor in zip(pieces, factors.tolist(), strict=True):
        out ^= np.frombuffer(piece.translate(_TIMES[factor]), np.uint8)
    return out


def restored(pieces: NDArray[np.uint8], missing: list[int], parity: Mapping[int, NDArray[np.uint8]]) -> None:
    """Fill the ``missing`` rows of ``pieces`` [K, N] from as many rows of ``parity``, a mapping from row number."""
    if not missing:
        return
    rows = np.array(sorted(parity)[: len(missing)])
    there = np.array([index for index in range(len(pieces)) if index not in set(missing)], np.int64)
    right = np.array([parity[int(row)] for row in rows])
    factors = _factors(rows, there)
    texts = [pieces[index].tobytes() for index in there]
    for index in range(len(rows) if texts else 0):
        right[index] ^= _summed(texts, factors[index])
    left = _factors(rows, np.array(missing))
    for index in range(len(missing)):  # Gauss-Jordan; a pivot is never zero in a Cauchy matrix
        inverse = _INVERSE[left[index, index]]
        left[index], right[index] = _PRODUCT[inverse, left[index]], _PRODUCT[inverse, right[index]]
        for other in range(len(missing)):
            if other != index and left[other, index]:
                factor = left[other, index]
                left[other] ^= _PRODUCT[factor, left[index]]
                right[other] ^= _PRODUCT[factor, right[index]]
    pieces[missing] = right
