"""The keyed pattern: the frequencies of a tile that locate it, those that carry bits, and their phases.

A tile is periodic and holds a ring of middle frequencies: lower ones are masked by the picture and most visible, higher
ones do not survive JPEG and scaling. A quarter of the frequencies (bins) are equal in every picture of a key and locate
the tile and its scale. Each other bin carries two signs of the code word, one in phase and one in quadrature.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32
from glsplat.extras.watermark.code import CODE_BITS

TILE = 64
"""Pixels per side: eight JPEG blocks, and a power of two, which divides usual picture sizes."""

BAND = (5.0, 18.0)
"""Cycles per tile: wavelengths of 12.8 to 3.6 pixels."""

_SYNC_SHARE = 0.25  # of the bins, to locate the tile

C64 = NDArray[np.complex64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """The N bins of a key; of each pair k, -k the one with kx > 0 or ky > 0."""

    kx: Index  # [N] cycles per tile to the right
    ky: Index  # [N] and downwards
    phase: C64  # [N] of magnitude 1, without the carried signs
    sync: Index  # bins that carry no bits
    data: Index  # bins that carry bits
    slots: Index  # [2 data] index into the code word: in phase, in quadrature, bin by bin

    def tile(self, word: NDArray[np.floating]) -> F32:
        """Return the tile [TILE, TILE] of mean 0 and variance 1 that carries the signs ``word`` [CODE_BITS]."""
        value = self.phase.astype(np.complex128)
        signs = word[self.slots].reshape(-1, 2)
        value[self.data] *= (signs[:, 0] + 1j * signs[:, 1]) / np.sqrt(2)
        spectrum = np.zeros((TILE, TILE), np.complex128)
        spectrum[self.ky, self.kx] = value  # negative indices count from the end
        spectrum[-self.ky, -self.kx] = value.conj()
        tile = np.fft.ifft2(spectrum).real
        return (tile / tile.std()).astype(np.float32)

    def soft(self, received: C64) -> F32:
        """Return the code word [CODE_BITS], signs times confidence, of the bins [N] of a located tile."""
        value = (received * self.phase.conj())[self.data]
        parts = np.stack([value.real, value.imag], axis=1).ravel()
        return np.bincount(self.slots, parts, CODE_BITS).astype(np.float32)


@lru_cache(maxsize=8)
def pattern_of(key: bytes) -> Pattern:
    """Return the pattern of a key. Its randomness is SHAKE-256 of the key (FIPS 202), equal on every machine."""
    ky, kx = np.mgrid[1 - TILE // 2 : TILE // 2, 0 : TILE // 2]
    radius = np.hypot(kx, ky)
    ring = (radius >= BAND[0]) & (radius <= BAND[1]) & ((kx > 0) | (ky > 0))
    kx, ky = kx[ring].astype(np.intp), ky[ring].astype(np.intp)
    bins = len(kx)
    order = _shuffled(key, b"order", bins)
    sync, data = np.split(order, [round(_SYNC_SHARE * bins)])
    angle = _words(key, b"phase", bins) * (2 * np.pi / 2**32)
    slots = _shuffled(key, b"slots", 2 * len(data)) % CODE_BITS
    return Pattern(kx, ky, np.exp(1j * angle).astype(np.complex64), np.sort(sync), np.sort(data), slots)


def _words(key: bytes, use: bytes, count: int) -> NDArray[np.uint32]:
    digest = hashlib.shake_256(b"glsplat watermark 1 " + use + b"\0" + key).digest(4 * count)
    return np.frombuffer(digest, "<u4")


def _shuffled(key: bytes, use: bytes, count: int) -> Index:
    return np.argsort(_words(key, use, count), kind="stable").astype(np.intp)
