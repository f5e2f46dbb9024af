"""Sound for an MP4 that has pictures only: a second track, of FLAC.

Boxes are those of ISO/IEC 14496-12; the track's description is "Encapsulation of FLAC in ISO Base Media File Format",
version 0.0.4 (Mozilla, in xiph/flac's doc/isoflac.txt).
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from glsplat.errors import FormatError
from glsplat.extras.speech.flac import BLOCK, LEAST, flac_frames, stream_info
from glsplat.extras.speech.sound import Sound

__all__ = ["add_sound"]

_MATRIX = struct.pack(">9I", 0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000)
_MOST = 2**32 - 1  # bytes, where a chunk may begin


def add_sound(path: Path, sound: Sound) -> None:
    """Append a track to the file, in place. Raises FormatError where its index is not the last of its boxes."""
    short = max(0, LEAST - len(sound.samples))
    sound = replace(sound, samples=np.pad(sound.samples, (0, short))) if short else sound
    with path.open("r+b") as file:
        start, movie = _movie(file, path)
        frames = flac_frames(sound)
        body = b"".join(frames)
        if start + len(body) + 8 > _MOST:
            raise FormatError(f"{path}: no sound fits behind 4 GiB of pictures")
        movie = _with_track(movie, sound, frames, start + 8)
        file.seek(start)
        file.write(struct.pack(">I4s", len(body) + 8, b"mdat") + body + movie)
        file.truncate()


def _movie(file: BinaryIO, path: Path) -> tuple[int, bytes]:
    """Where the last box, ``moov``, begins, and what is in it."""
    place = 0
    while len(head := file.read(8)) == 8:
        size, name = struct.unpack(">I4s", head)
        if size == 1:
            size = int.from_bytes(file.read(8), "big")
        if name == b"moov":
            body = file.read(size - 8)
            if not file.read(1):
                return place, body
        if size < 8:
            break
        place += size
        file.seek(place)
    raise FormatError(f"{path}: its index is not where sound can be added; give a folder/ of pictures")


def _with_track(movie: bytes, sound: Sound, frames: list[bytes], offset: int) -> bytes:
    """``moov`` with one more track, of which the frames begin at ``offset``."""
    size = int.from_bytes(movie[:4], "big")
    if movie[4:8] != b"mvhd" or movie[8] != 0 or size > len(movie):
        raise FormatError("the clip's index does not begin as it should")
    header = bytearray(movie[:size])
    scale, length = struct.unpack_from(">II", header, 20)
    number = int.from_bytes(header[-4:], "big")
    spoken = round(sound.seconds * scale)
    struct.pack_into(">I", header, 24, max(length, spoken))
    header[-4:] = (number + 1).to_bytes(4, "big")
    return _box(b"moov", bytes(header), movie[size:], _track(number, spoken, sound, frames, offset))


def _track(number: int, length: int, sound: Sound, frames: list[bytes], offset: int) -> bytes:
    count, rest = divmod(len(sound.samples), BLOCK)
    times = [(count, BLOCK)] * (count > 0) + [(1, rest)] * (rest > 0)
    rate = sound.rate << 16 if sound.rate < 1 << 16 else 0  # what does not fit is in STREAMINFO alone
    info = b"\x80" + (34).to_bytes(3, "big") + stream_info(sound, frames)
    entry = struct.pack(">6xH8xHHHHI", 1, 1, 16, 0, 0, rate) + _full(b"dfLa", info)
    table = _box(
        b"stbl",
        _full(b"stsd", struct.pack(">I", 1), _box(b"fLaC", entry)),
        _full(b"stts", struct.pack(">I", len(times)), *(struct.pack(">II", *one) for one in times)),
        _full(b"stsc", struct.pack(">IIII", 1, 1, len(frames), 1)),
        _full(b"stsz", struct.pack(f">II{len(frames)}I", 0, len(frames), *map(len, frames))),
        _full(b"stco", struct.pack(">II", 1, offset)),
    )
    here = _full(b"dref", struct.pack(">I", 1), _full(b"url ", flags=1))
    media = _box(
        b"mdia",
        _full(
            b"mdhd", struct.pack(">IIIIHH", 0, 0, sound.rate, len(sound.samples), 0x55C4, 0)
        ),  # language: undetermined
        _full(b"hdlr", struct.pack(">I4s12x", 0, b"soun"), b"sound\0"),
        _box(b"minf", _full(b"smhd", bytes(4)), _box(b"dinf", here), table),
    )
    header = struct.pack(">IIIII8xHHHH", 0, 0, number, 0, length, 0, 0, 0x100, 0) + _MATRIX + struct.pack(">II", 0, 0)
    return _box(b"trak", _full(b"tkhd", header, flags=3), media)


def _box(name: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", len(body) + 8, name) + body


def _full(name: bytes, *parts: bytes, flags: int = 0) -> bytes:
    return _box(name, struct.pack(">I", flags), *parts)
