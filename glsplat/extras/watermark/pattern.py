"""The keyed pattern: which frequencies of the tile find it, which carry bits, and in which phase each is expected.

A tile is periodic and holds nothing but a ring of middle frequencies: lower ones lie under the picture's own content
and are seen first, higher ones do not survive JPEG and scaling. Each frequency (bin) of the ring belongs to one of two
parts. Those of the first are the same in every picture under a key: they say where a tile begins and how it is scaled.
Each bin of the second carries two signs of the code word, one in phase and one in quadrature.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.watermark.code import CODE_BITS

__all__ = ["BAND", "TILE", "Pattern", "pattern_of"]

TILE = 64
"""Pixels a side: eight blocks of JPEG, and a power of two, so that it fits the usual sizes of pictures."""

BAND = (5.0, 18.0)
"""Cycles a tile: wave lengths of 12.8 to 3.6 pixels."""

_SYNC_SHARE = 0.25  # of the bins

F32 = NDArray[np.float32]
C64 = NDArray[np.complex64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """What a key makes of the ring, bin by bin (N bins; of each pair k, -k the one with kx > 0 or ky > 0)."""

    kx: Index  # [N] cycles a tile to the right
    ky: Index  # [N] and downwards
    phase: C64  # [N] of magnitude 1: what a bin is, but for the signs it carries
    sync: Index  # bins that carry nothing
    data: Index  # bins that carry signs
    slots: Index  # [2 data] which sign of the code word: in phase, in quadrature, of bin after bin

    def tile(self, word: NDArray[np.floating]) -> F32:
        """[TILE, TILE] of mean 0 and variance 1 that carries the signs ``word`` [CODE_BITS]."""
        value = self.phase.astype(np.complex128)
        signs = word[self.slots].reshape(-1, 2)
        value[self.data] *= (signs[:, 0] + 1j * signs[:, 1]) / np.sqrt(2)
        spectrum = np.zeros((TILE, TILE), np.complex128)
        spectrum[self.ky, self.kx] = value  # negative ones count from the end
        spectrum[-self.ky, -self.kx] = value.conj()
        tile = np.fft.ifft2(spectrum).real
        return (tile / tile.std()).astype(np.float32)

    def soft(self, received: C64) -> F32:
        """The code word as signs times confidence [CODE_BITS], of the ``received`` bins [N] of a tile at its place."""
        value = (received * self.phase.conj())[self.data]
        parts = np.stack([value.real, value.imag], axis=1).ravel()
        return np.bincount(self.slots, parts, CODE_BITS).astype(np.float32)


@lru_cache(maxsize=8)
def pattern_of(key: bytes) -> Pattern:
    """The pattern of a key. All chance in it is SHAKE-256 of the key (FIPS 202), the same on every machine."""
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
