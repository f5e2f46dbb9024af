"""SPZ: Niantic's packed splats, versions 1 to 4. spz_packing.py has the encoding of attributes.

A header of 16 bytes and the attributes, as one gzip stream (versions 1 to 3), which some tools leave unpacked; or
(version 4) a header of 32 bytes, a table of sizes, and each attribute as a zstd stream. Vendors' extensions follow the
attributes, or in version 4 the header; the one that names other axes is applied, the rest are skipped.
"""

from __future__ import annotations

import io
import logging
import struct
import sys
import zlib
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import accumulate
from types import ModuleType
from typing import BinaryIO

import numpy as np

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.extras.formats.spz_packing import HALF_TURN, Bytes, SpzHeader, lost, packed, position_bits, unpacked
from glsplat.formats.format import Format, Opened, clamped_opacities
from glsplat.formats.transform import transformed
from glsplat.io.files import Source, replace_file
from glsplat.optional import has_package, missing_package
from glsplat.splats import Splats

_MAGIC, _GZIP = b"NGSP", b"\x1f\x8b"
_HEADER = struct.Struct("<4sIIBBBB")
_ANTIALIAS, _EXTENDED, _TREE = 1, 2, 0x80  # flags
_EXTENSIONS = 1 << 16  # most bytes of vendors' extensions
_AXES = 0xADBE0003  # the extension SPZ_ADOBE_coordinate_system, one of _SYSTEMS
_SYSTEMS = ("RUB", *"LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU".split())
_AMBIGUOUS = ("LFD", "RFD", "LBU", "RBU")  # Niantic's library stores them turned by half a turn about x
_DIRECTIONS = {"R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0), "U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)}
_BLOCK = 1 << 20
_DEFLATED = 1032  # largest compression ratio of deflate
_ZSTD_POSITIONS = 1024 / 9  # most splats a byte of the file, as in Niantic's reader
_WRITTEN = 3  # version

log: logging.Logger = logging.getLogger("glsplat.formats")


def read_spz(file: BinaryIO, size: int, *, turn: bool = True) -> Splats:
    """Read an open file of ``size`` bytes in the axes of a 3DGS PLY (y down).

    Without ``turn`` y is up and z back, as SPZ stores them. Spherical harmonics of degree 4 are cut to degree 3, which
    is logged. Non-finite values, which only version 1 can hold, are kept. Raises FormatError: no SPZ, truncated, a
    count that the file cannot hold, a broken stream, or a level-of-detail tree, whose splats must not all be drawn.

    Counts are checked against the file before allocation, and only the bytes of the header's count are unpacked.
    """
    head = file.read(32)
    file.seek(0)
    if head[:2] == _GZIP:
        stream = _Inflated(file)
        header, attributes, extensions = _single(stream.read, size * _DEFLATED)
        stream.end()
    elif head[:4] == _MAGIC and head[4:8] == b"\4\0\0\0":
        header, attributes, extensions = _streams(file, size, head)
    else:
        header, attributes, extensions = _single(file.read, size)
    if header.degree > 3:
        log.warning("spherical harmonics of degree %d are cut to degree 3 (%d splats)", header.degree, header.count)
    return _turned(unpacked(header, attributes, turn=turn), extensions)


def spz_splats(data: bytes) -> Splats:
    """Read the splats of an SPZ file in a bufferView of glTF (KHR_gaussian_splatting_compression_spz_2).

    Axes are not changed: the accessors' bounds in real files are those of the stored numbers, and CesiumJS and Cesium
    Native read them so. Raises FormatError.
    """
    return read_spz(io.BytesIO(data), len(data), turn=False)


def save_spz(splats: Splats, target: Source, *, version: int = _WRITTEN) -> None:
    """Write an .spz file of version 3, or 2, whose rotations are coarser, for programs from before August 2025.

    Most programs read version 3; version 4 packs the same numbers a little smaller, and few read it yet. Splats are
    turned by half a turn about x, as in other converters from PLY. Raises FormatError if ``target`` cannot be written.
    """
    if version not in (2, 3):
        raise FormatError(f"SPZ is written as version 2 or 3, not {version!r:.20}")
    header = SpzHeader(version, len(splats), splats.sh_degree, position_bits(splats), splats.antialias)
    replace_file(target, _gzipped(splats, header))


def _gzipped(splats: Splats, header: SpzHeader) -> Iterator[bytes]:
    pack = zlib.compressobj(wbits=31, memLevel=9)  # its header has no time and no name
    flags = _ANTIALIAS * header.antialias
    yield pack.compress(_HEADER.pack(_MAGIC, header.version, header.count, header.degree, header.bits, flags, 0))
    for part in packed(splats, header):
        yield pack.compress(part)
    yield pack.flush()


class _Inflated:
    """A gzip stream, unpacked only as far as it is read."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._unpack = file, zlib.decompressobj(31)

    def read(self, count: int) -> bytearray:
        """Read the next ``count`` bytes, fewer at the end."""
        out = bytearray()
        while len(out) < count and not self._unpack.eof:
            block = self._unpack.unconsumed_tail or self._file.read(_BLOCK)
            if not block:
                raise FormatError("truncated: the gzip stream has no end")
            try:
                out += self._unpack.decompress(block, count - len(out))
            except zlib.error as error:
                raise FormatError(f"the gzip stream is broken ({str(error)[:80]})") from None
        return out

    def end(self) -> None:
        """Check that only padding follows. Raises FormatError."""
        if (self._unpack.unused_data + self._file.read(_BLOCK)).strip(b"\0"):
            raise FormatError("something follows the end of the gzip stream; is this one file?")


def _single(read: Callable[[int], Bytes], most: int) -> tuple[SpzHeader, list[Bytes], Bytes]:
    """Read header, attributes and extensions of versions 1 to 3 from a stream of at most ``most`` bytes."""
    header, flags = _header(read(_HEADER.size), 3)
    needed = header.count * sum(header.widths)
    if needed > most:
        raise FormatError(f"truncated: {header.count} splats are declared, which take more than the file can hold")
    data = read(needed)
    if len(data) < needed:
        raise FormatError(f"truncated: {header.count} splats take {needed} bytes, {len(data)} are there")
    rest = read(_EXTENSIONS)
    if rest and not flags & _EXTENDED:
        raise FormatError(f"{header.count} splats are declared, but the file holds more")
    if len(rest) == _EXTENSIONS:
        raise FormatError(f"the extensions behind the splats need to be smaller than {_EXTENSIONS} bytes")
    ends = list(accumulate(header.count * width for width in header.widths))
    view = memoryview(data)
    return header, [view[start:end] for start, end in zip([0, *ends], ends, strict=False)], rest


def _streams(file: BinaryIO, size: int, head: bytes) -> tuple[SpzHeader, list[Bytes], Bytes]:
    """Read header, attributes and extensions of version 4; each attribute with bytes has its own stream."""
    if len(head) < 32:
        raise FormatError(f"truncated: the header of SPZ version 4 has 32 bytes, this file has {len(head)}")
    header, flags = _header(head[: _HEADER.size], 4)
    number, table = head[15], int.from_bytes(head[16:20], "little")
    if header.count > size * _ZSTD_POSITIONS:
        raise FormatError(f"truncated: {header.count} splats are declared, more than {size} bytes can hold")
    needed = [header.count * width for width in header.widths]
    sizes = [count for count in needed if count]
    if number != len(sizes):
        raise FormatError(f"the splats need {len(sizes)} streams, the header declares {number}")
    if not 32 <= table <= size - 16 * number:
        raise FormatError(f"truncated: the table of streams is declared at byte {table}, the file has {size}")
    file.seek(32)
    extensions = file.read(min(table - 32, _EXTENSIONS)) if flags & _EXTENDED else b""
    file.seek(table)
    entries = list(struct.iter_unpack("<QQ", file.read(16 * number)))
    if [unpacked_size for _, unpacked_size in entries] != sizes:
        raise FormatError(f"the streams of {header.count} splats of this degree need other sizes than are declared")
    if sum(packed_size for packed_size, _ in entries) != size - table - 16 * number:
        raise FormatError("truncated, or too long: the streams' sizes do not add up to the file's")
    streams = iter(entries)
    return header, [_stream(file, *next(streams)) if count else b"" for count in needed], extensions


def _stream(file: BinaryIO, left: int, size: int) -> bytearray:
    """Unpack exactly ``size`` bytes from the next ``left``. Raises FormatError otherwise."""
    zstd = _zstd()
    unpack, out = zstd.ZstdDecompressor(), bytearray()
    while not unpack.eof and len(out) <= size:
        block = file.read(min(_BLOCK, left)) if unpack.needs_input else b""
        left -= len(block)
        if unpack.needs_input and not block:
            raise FormatError("truncated: a zstd stream has no end")
        try:
            out += unpack.decompress(block, size + 1 - len(out))
        except zstd.ZstdError as error:
            raise FormatError(f"a zstd stream is broken ({str(error)[:80]})") from None
    if len(out) != size or left or unpack.unused_data:
        raise FormatError(f"a zstd stream needs to hold {size} bytes and no more")
    return out


def _zstd() -> ModuleType:
    name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    if not has_package(name):
        raise FormatError(missing_package("SPZ version 4", name, "spz") + ", or convert it to version 3")
    return import_module(name)


def _header(data: Bytes, newest: int) -> tuple[SpzHeader, int]:
    """Return the checked header and its flags."""
    if len(data) < _HEADER.size or data[:4] != _MAGIC:
        raise FormatError("not an SPZ file: it does not start with a header of 16 bytes that begins with NGSP")
    _, version, count, degree, bits, flags, _ = _HEADER.unpack(data)
    if not 1 <= version <= newest:
        raise FormatError(f"needs SPZ version 1 to 4 (3 within gzip), found {version}")
    if degree > 4 or bits > 24:
        raise FormatError(f"needs SH of degree 0 to 4 and 0 to 24 fractional bits, found {degree} and {bits}")
    if flags & _TREE:
        raise FormatError("holds a level-of-detail tree (flag 0x80); export the splats without it")
    return SpzHeader(version, count, degree, bits, bool(flags & _ANTIALIAS)), flags


def _turned(splats: Splats, extensions: Bytes) -> Splats:
    """Transform ``splats``, read with SPZ's axes, from the axes named by an extension."""
    system, at = "RUB", 0
    while at + 8 <= len(extensions):
        kind, length = struct.unpack_from("<II", extensions, at)
        if kind == _AXES and length == 4 and at + 12 <= len(extensions):
            code = int.from_bytes(extensions[at + 8 : at + 12], "little")
            if code >= len(_SYSTEMS):
                raise FormatError(f"its extension for axes names system {code}, but there are 1 to 16")
            system = _SYSTEMS[code]
            if system in _AMBIGUOUS:
                raise FormatError(f"its extension names the axes {system}, which mean two things; export it as RUB")
        at += 8 + length
    if system == "RUB":
        return splats
    matrix = np.eye(4)
    # to x right, y up, z back; commutes with the half turn, so it may come after it
    matrix[:3, :3] = HALF_TURN @ np.transpose([_DIRECTIONS[letter] for letter in system])
    return transformed(splats, matrix)


def _sniff(start: Opened) -> bool:
    if start.head[:2] == _GZIP:
        try:
            head = zlib.decompressobj(31).decompress(start.head, 8)
        except zlib.error:
            return False
    else:
        head = start.head
    # a .splat may begin with these bytes, but hardly with such a small number next
    return head[:4] == _MAGIC and head[5:8] == b"\0\0\0" and head[4] > 0


def _loses(scene: Splats | Avatar) -> Iterator[str]:
    splats = splats_of(scene)
    yield from clamped_opacities(scene)
    yield from lost(splats)


SPZ = Format(
    name="spz",
    title="SPZ",
    suffixes=(".spz",),
    sniff=_sniff,
    load=lambda start: read_spz(start.file, start.size),
    save=lambda scene, target: save_spz(splats_of(scene), target),
    loses=_loses,
)
