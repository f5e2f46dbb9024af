"""Sound files: read RIFF WAVE of integers or floats with all sizes checked.

Chunks: "Multimedia Programming Interface and Data Specifications 1.0" (IBM & Microsoft 1991); the extensible format:
Microsoft's mmreg.h.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.io.files import naming, open_regular

MAX_BYTES = 512 * 2**20
MAX_SECONDS = 3600.0
MAX_VALUES = 1 << 28  # of all channels: an hour of stereo at 37 kHz
_BLOCK_SAMPLES = 1 << 20  # converted at once
MAX_CHUNKS = 1000

_INTEGER, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
_KINDS = {(_INTEGER, 8): "u1", (_INTEGER, 16): "<i2", (_INTEGER, 24): "", (_INTEGER, 32): "<i4"}
_KINDS |= {(_FLOAT, 32): "<f4", (_FLOAT, 64): "<f8"}


@dataclass(frozen=True, slots=True, eq=False)
class Sound:
    """One channel: ``samples`` [N], full scale 1, at ``rate`` samples per second."""

    samples: NDArray[np.float32]
    rate: int

    @property
    def seconds(self) -> float:
        """Duration in seconds."""
        return len(self.samples) / self.rate


def read_wav(path: str | Path) -> Sound:
    """Return the mean of a .wav's channels. Raises FormatError for other files and codecs, and above an hour."""
    with naming(path), open_regular(path) as (file, size):
        if size > MAX_BYTES:
            raise FormatError(f"a sound file needs at most {MAX_BYTES >> 20} MiB, not {size >> 20}")
        return _parsed(file.read(size))


def _parsed(data: bytes) -> Sound:
    if data[:4] != b"RIFF" or data[8:12] != b"WAVE":
        raise FormatError("expected a .wav (RIFF WAVE), found something else; ffmpeg -i IT it.wav makes one")
    form: tuple[int, int, int, int] | None = None
    position = 12
    for _ in range(MAX_CHUNKS):
        if position + 8 > len(data):
            break
        name, size = data[position : position + 4], int.from_bytes(data[position + 4 : position + 8], "little")
        body = data[position + 8 : position + 8 + size]
        if name == b"fmt ":
            form = _form(body)
        if name == b"data":
            if form is None:
                raise FormatError("a .wav whose sound comes before its format")
            return _sound(body, *form)  # streams have a wrong length; use the bytes that there are
        position += 8 + size + size % 2
    raise FormatError("a .wav without sound in it")


def _form(body: bytes) -> tuple[int, int, int, int]:
    if len(body) < 16:
        raise FormatError("a .wav whose format is cut off")
    kind, channels, rate, _, _, bits = struct.unpack_from("<HHIIHH", body)
    if kind == _EXTENSIBLE and len(body) >= 26:
        kind = int.from_bytes(body[24:26], "little")
    if (kind, bits) not in _KINDS:
        raise FormatError(
            f"a .wav of format {kind} with {bits} bits; 8 to 32 bits or floats are read (ffmpeg converts)"
        )
    if not 1 <= channels <= 64 or not 1 <= rate <= 10**6:
        raise FormatError(f"a .wav of {channels} channels, {rate} samples a second")
    return kind, channels, rate, bits


def _sound(body: bytes, kind: int, channels: int, rate: int, bits: int) -> Sound:
    width = channels * bits // 8
    count = len(body) // width
    if not count:
        raise FormatError("a .wav without a sample in it")
    if count > MAX_SECONDS * rate:
        raise FormatError(f"a .wav of {count / rate:.0f} s; {MAX_SECONDS:.0f} are read")
    if count * channels > MAX_VALUES:
        raise FormatError(f"a .wav of {count * channels} numbers; {MAX_VALUES} are read (ffmpeg -ar 48000 -ac 1)")
    samples = np.empty(count, np.float32)
    for first in range(0, count, _BLOCK_SAMPLES):  # limits the memory of the conversion to float64
        part = body[first * width : min(first + _BLOCK_SAMPLES, count) * width]
        whole = _numbers(part, kind, bits).reshape(-1, channels)
        samples[first : first + len(whole)] = whole.mean(axis=1).clip(-4, 4)
    return Sound(samples, rate)


def _numbers(body: bytes, kind: int, bits: int) -> NDArray[np.float64]:
    """Return samples with full scale 1; NaN and infinity as 0."""
    if bits == 24:
        bytes3 = np.frombuffer(body, np.uint8).reshape(-1, 3).astype(np.int32)
        return (bytes3[:, 0] << 8 | bytes3[:, 1] << 16 | bytes3[:, 2] << 24) / 2.0**31
    numbers = np.frombuffer(body, _KINDS[kind, bits]).astype(np.float64)
    if kind == _FLOAT:
        return np.nan_to_num(numbers, nan=0.0, posinf=0.0, neginf=0.0)
    return (numbers - 128) / 128 if bits == 8 else numbers / 2.0 ** (bits - 1)
