"""Make PNG files safe for OpenCV's decoder: keep only the chunks that pixels need, checked.

OpenCV's libpng prints to stderr for most damaged files. Pillow does not, but meshes load without it.
"""

from __future__ import annotations

import struct
import zlib

from glsplat.errors import FormatError

_NEEDED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by colour type
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


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
