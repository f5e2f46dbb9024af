"""FLAC: the sound of clips, exact, played by every browser and free of patents; a plain encoder of one channel.

RFC 9639. Fixed predictors of order 0 to 2 (section 9.2.5), one partition of Rice codes (9.2.7): some 60 % of the bytes.
"""

from __future__ import annotations

import hashlib
from functools import cache

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.sound import Sound

__all__ = ["BLOCK", "LEAST", "flac_frames", "stream_info"]

BLOCK = 4096
"""Samples of a frame; the last one has fewer."""
LEAST = 16
"""Samples that a stream needs."""
_BITS = 16
_MOST = 14  # of a Rice parameter


def flac_frames(sound: Sound) -> list[bytes]:
    """The frames, each of ``BLOCK`` samples of 16 bits."""
    numbers = _whole(sound)
    return [_frame(i, numbers[first : first + BLOCK]) for i, first in enumerate(range(0, len(numbers), BLOCK))]


def stream_info(sound: Sound, frames: list[bytes]) -> bytes:
    """The 34 bytes of STREAMINFO (section 8.2)."""
    numbers = _whole(sound)
    sizes = [len(frame) for frame in frames]
    packed = sound.rate << 44 | (_BITS - 1) << 36 | len(numbers)  # 20 bits, 3 of channels - 1, 5, 36
    head = BLOCK.to_bytes(2, "big") * 2 + min(sizes).to_bytes(3, "big") + max(sizes).to_bytes(3, "big")
    return (
        head + packed.to_bytes(8, "big") + hashlib.md5(numbers.astype("<i2").tobytes(), usedforsecurity=False).digest()
    )


def _whole(sound: Sound) -> NDArray[np.int64]:
    return np.rint(sound.samples.astype(np.float64).clip(-1, 1) * 32767).astype(np.int64)


def _frame(number: int, samples: NDArray[np.int64]) -> bytes:
    # sync and fixed blocks; block size of 16 bits below, rate as in STREAMINFO; one channel of 16 bits
    head = b"\xff\xf8\x70\x08" + _coded(number) + (len(samples) - 1).to_bytes(2, "big")
    head += _crc(head, 0x07, 8).to_bytes(1, "big")
    body = head + np.packbits(_subframe(samples)).tobytes()
    return body + _crc(body, 0x8005, 16).to_bytes(2, "big")


def _subframe(samples: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Its bits, one a byte."""
    orders = range(min(3, len(samples)))
    order = min(orders, key=lambda o: int(np.abs(np.diff(samples, o)).sum()))
    residual = np.diff(samples, order)
    folded = np.where(residual < 0, -2 * residual - 1, 2 * residual)
    mean = int(folded.mean()) if len(folded) else 0
    k = min(_MOST, mean.bit_length() - 1 if mean else 0)
    high = folded >> k
    starts = np.cumsum(high + 1 + k) - (high + 1 + k)
    codes = np.zeros(int((high + 1 + k).sum()), np.uint8)
    codes[starts + high] = 1
    for bit in range(k):
        codes[starts + high + 1 + bit] = folded >> (k - 1 - bit) & 1
    head = _bits(0b001000 | order, 7) + _bits(0, 1)
    warm = [bit for sample in samples[:order] for bit in _bits(int(sample) & 0xFFFF, _BITS)]
    return np.concatenate([np.array([*head, *warm, *_bits(k, 2 + 4 + 4)], np.uint8), codes])  # method 0, one partition


def _bits(value: int, count: int) -> list[int]:
    return [value >> i & 1 for i in reversed(range(count))]


def _coded(number: int) -> bytes:
    """The frame's number in the way of UTF-8, up to 31 bits (section 9.1.5)."""
    if number < 0x80:
        return bytes([number])
    count = next(n for n in range(2, 7) if number < 1 << (5 * n + 1))
    rest = [0x80 | number >> 6 * i & 0x3F for i in reversed(range(count - 1))]
    return bytes([(0xFF << (8 - count) & 0xFF) | number >> 6 * (count - 1), *rest])


def _crc(data: bytes, polynomial: int, width: int) -> int:
    table, crc, mask = _table(polynomial, width), 0, (1 << width) - 1
    for byte in data:
        crc = (crc << 8 ^ table[crc >> (width - 8) ^ byte]) & mask
    return crc


@cache
def _table(polynomial: int, width: int) -> list[int]:
    out = []
    for byte in range(256):
        crc = byte << (width - 8)
        for _ in range(8):
            crc = crc << 1 ^ (polynomial if crc >> (width - 1) & 1 else 0)
        out.append(crc & ((1 << width) - 1))
    return out
