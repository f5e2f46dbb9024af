"""Decode textures of meshes: JPEG, PNG and WebP to RGBA, checked before any pixel is decoded.

OpenCV's libpng prints to stderr for most damaged PNG files, so that only the chunks that pixels need are passed on,
checked. Pillow does not print, but meshes load without it.
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.errors import FormatError

_NEEDED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))

_LONGEST = 16_384  # pixels a side; the limit of GL
_MOST = 1 << 26  # pixels: a small file may claim more than memory


def clean_png(data: bytes) -> bytes:
    """Return the PNG with only its pixels. ``data`` has passed ``read_header``. Raises FormatError for damage."""
    chunks: dict[bytes, list[bytes]] = {name: [] for name in _NEEDED}
    place, name = 8, b""
    while name != b"IEND":
        length, name = struct.unpack_from(">I4s", data, place)
        if name in chunks:
            chunks[name].append(data[place + 8 : place + 8 + length])
        place += 12 + length
    for name, most in ((b"IHDR", 1), (b"PLTE", 1), (b"tRNS", 1), (b"IEND", 1)):
        if len(chunks[name]) > most:
            raise _damage(f"{name.decode()} comes twice")
    if len(chunks[b"IHDR"][0]) != 13:
        raise _damage("its header has a wrong length")
    width, height, depth, colour, packing, filtering, woven = struct.unpack(">IIBBBBB", chunks[b"IHDR"][0])
    if depth not in _DEPTHS.get(colour, ()) or packing or filtering or woven > 1:
        raise _damage("its header has no valid kind of pixels")
    palette = _palette(chunks, colour, depth)
    rows = _rows(width, height, _CHANNELS[colour] * depth, bool(woven))
    packed = b"".join(chunks[b"IDAT"])
    pixels, used = _unpacked(packed, sum(count * (1 + size) for count, size in rows))
    start = 0
    for count, size in rows:
        if count and max(pixels[start : start + count * (1 + size) : 1 + size]) > 4:
            raise _damage("its rows have an invalid filter")
        start += count * (1 + size)
    parts = [(b"IHDR", chunks[b"IHDR"][0]), *palette, (b"IDAT", packed[:used]), (b"IEND", b"")]
    out = [struct.pack(">I", len(b)) + n + b + struct.pack(">I", zlib.crc32(b, zlib.crc32(n))) for n, b in parts]
    return data[:8] + b"".join(out)


def _palette(chunks: dict[bytes, list[bytes]], colour: int, depth: int) -> list[tuple[bytes, bytes]]:
    """Return the palette, padded so that every pixel has an entry, and its transparency."""
    if colour != 3:
        clear = chunks[b"tRNS"][0] if chunks[b"tRNS"] else b""
        return [(b"tRNS", clear)] if len(clear) == {0: 2, 2: 6}.get(colour) else []
    entries = chunks[b"PLTE"][0] if chunks[b"PLTE"] else b""
    if not entries or len(entries) % 3 or len(entries) > 3 << depth:
        raise _damage("its palette is missing or has a wrong length")
    parts = [(b"PLTE", entries.ljust(3 << depth, b"\0"))]
    if chunks[b"tRNS"] and chunks[b"tRNS"][0]:
        parts.append((b"tRNS", chunks[b"tRNS"][0][: 1 << depth]))
    return parts


def _rows(width: int, height: int, bits: int, woven: bool) -> list[tuple[int, int]]:
    """Return the number of rows and the bytes of a row without its filter byte; seven pairs if interlaced."""
    sizes = [(width, height)]
    if woven:
        sizes = [(-(-(width - x) // dx), -(-(height - y) // dy)) for x, y, dx, dy in _ADAM7]
    return [(h, (w * bits + 7) // 8) for w, h in sizes if w > 0 and h > 0]


def _unpacked(packed: bytes, size: int) -> tuple[bytes, int]:
    """Return the ``size`` bytes of pixels with filter bytes, and the number of their packed bytes."""
    machine = zlib.decompressobj()
    try:
        pixels = machine.decompress(packed, size)
        more = machine.decompress(machine.unconsumed_tail, 1)  # only the check sum may follow
    except zlib.error as error:
        raise _damage(str(error).rsplit(": ", 1)[-1]) from None
    if len(pixels) != size or more or not machine.eof:
        raise _damage(f"it has {len(pixels)} bytes of pixels{' and more' if more else ''}, expected {size}")
    return pixels, len(packed) - len(machine.unused_data)


def _damage(what: str) -> FormatError:
    return FormatError(f"the PNG file is damaged ({what}); copy it again")


def decode_texture(data: bytes | NDArray[np.uint8], where: str) -> NDArray[np.uint8]:
    """Decode a JPEG, PNG or WebP to RGBA uint8 [H, W, 4]. Raises FormatError naming ``where`` for others and damage."""
    buffer = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data
    if buffer.dtype != np.uint8 or buffer.ndim != 1:
        raise FormatError(f"{where}: a texture is the bytes of a file, not {buffer.dtype} of shape {buffer.shape}")
    said = bytes(buffer[:32])
    width, height = _size(said, buffer)
    if not (width and height):
        raise FormatError(f"{where}: a texture is a JPEG, PNG or WebP, found {said[:4]!r}")
    if width * height > _MOST and max(width, height) <= _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_MOST >> 20} Mi pixels, this one {width} x {height}")
    if max(width, height) > _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_LONGEST} pixels a side, this one {width} x {height}")
    try:
        image = _decoded(said, buffer)
    except (cv2.error, MemoryError, ValueError, RuntimeError, struct.error, IndexError):
        image = None
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None
    if image is None:
        raise FormatError(f"{where}: the texture, {width} x {height} pixels, cannot be decoded (damaged?)")
    return image


def decoded_silently(data: NDArray[np.uint8]) -> Any:
    """Return OpenCV's picture of a file's bytes, with alpha and colours where it is 0; None for damage."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the caller's error is the only line
    try:
        return cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)


def _decoded(head: bytes, data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Decode to RGBA; return None or raise the decoder's error for damage. Nothing is printed to stderr."""
    if head.startswith(b"\xff\xd8"):
        space = simplejpeg.decode_jpeg_header(data, strict=False)[2]
        if space != "CMYK":
            return cv2.cvtColor(simplejpeg.decode_jpeg(data, "RGB", strict=False), cv2.COLOR_RGB2RGBA)
    if head.startswith(b"\x89PNG"):
        data = np.frombuffer(clean_png(data.tobytes()), np.uint8)
    image = decoded_silently(data)
    if image is None:
        return None
    if image.dtype != np.uint8:
        image = (image / 257).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGBA if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def _size(head: bytes, data: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the width and height in a picture's header; 0, 0 for other kinds."""
    if len(head) < 32:
        return 0, 0
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        width, height = struct.unpack_from(">II", head, 16)
        return width, height
    if head.startswith(b"RIFF") and head[8:15] == b"WEBPVP8":
        lossy, kind = struct.unpack_from("<I", head, 26)[0], head[15:16]
        if kind == b"X":
            wide, high = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
            return wide, high
        bits = struct.unpack_from("<I", head, 21)[0]
        if kind == b"L":
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        return lossy & 0x3FFF, lossy >> 16 & 0x3FFF
    if head.startswith(b"\xff\xd8"):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data, strict=False)
            return width, height
        except (ValueError, RuntimeError, KeyError):
            pass
    return 0, 0
