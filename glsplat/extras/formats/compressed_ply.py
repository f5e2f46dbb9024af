"""Compressed PLY (PlayCanvas, SuperSplat, splat-transform): 16 bytes a splat, in chunks of 256 with common bounds.

Element ``chunk`` has min_/max_ of x y z, of scale_x/y/z (natural logarithms) and usually of r g b; without these,
colours lie in 0 to 1. Element ``vertex`` has four words of 32 bits, the first component in the highest bits:

- packed_position, packed_scale: 11, 10 and 11 bits between the chunk's bounds: steps of 1/2047, 1/1023 and 1/2047 of
  its extent, so errors of at most half of that
- packed_rotation: 2 bits for the largest of w x y z, which is positive, then the other three in that order, 10 bits
  each between -+sqrt(1/2): steps of 0.0014, turned by at most 0.28 degrees
- packed_color: 8 bits each for r g b between the bounds (rgb = 0.5 + SH_C0 f_dc) and for the opacity, 0 to 1

The optional element ``sh`` has f_rest_0..(9|24|45) channel-major as bytes: 0 is -4, 255 is 4, else the middle of one
of 256 equal parts of -4 to 4: errors of at most 1/64 (1/32 in the outermost parts). Zero is not a middle and is read
as 1/64. Frame and comments are those of the plain PLY.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.extras.formats.packed import morton_order, read_rows, smallest_three, with_largest
from glsplat.formats.format import Format, Opened, clamped_opacities, positive_scales
from glsplat.formats.ply import ANTIALIAS, PACKED, Element, is_ply, read_header, sh_degree
from glsplat.io.files import Source, replace_file
from glsplat.splats import SH_C0, Splats

_SNIFFED = 1 << 16  # bytes of a header
_CHUNK = 256
_BLOCK = 128 * _CHUNK  # splats converted at a time
_POSITION, _SCALE, _COLOUR = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
_WORDS = (PACKED, "packed_rotation", "packed_scale", "packed_color")
_THREE, _ROTATION, _FOUR = (11, 10, 11), (2, 10, 10, 10), (8, 8, 8, 8)  # bits
_LOG_LIMIT = 20.0  # of the logarithms of scales, as in other writers: 2 nm to 485,000 km
_SH_RANGE = 4.0
_SH_VALUES = ((np.arange(256, dtype=np.float32) + np.float32(0.5)) / 128 - 1) * np.float32(_SH_RANGE)
_SH_VALUES[[0, 255]] = -_SH_RANGE, _SH_RANGE


def read_compressed_ply(file: BinaryIO, size: int) -> Splats:
    """Read the splats of an open file of ``size`` bytes, in its order.

    Raises FormatError if the header is incomplete, or declares more than the file holds.
    """
    header = read_header(file)
    if not header.order:
        raise FormatError("a compressed PLY is binary, but the header of this one says ASCII")
    tables: dict[str, tuple[int, np.dtype[np.void]]] = {}  # start in bytes, type of a row
    end = header.start
    for element in header.elements:
        if element.lists:
            raise FormatError(f"the element {element.name[:40]!r} has a list property; a compressed PLY has none")
        table = end, element.dtype(header.order)
        end += element.count * table[1].itemsize
        tables.setdefault(element.name, table)

    def rows_of(name: str, at: int, count: int) -> NDArray[np.void]:
        start, dtype = tables[name]
        return read_rows(file, start + at * dtype.itemsize, count, dtype)

    chunk, vertex, sh = (header.element(name) for name in ("chunk", "vertex", "sh"))
    if chunk is None or vertex is None:
        raise FormatError("a compressed PLY needs the elements chunk and vertex")
    coloured = _check_properties(chunk, vertex)
    degree = _check_harmonics(sh, vertex.count)
    if end > size:
        raise FormatError(f"truncated: the header declares {end} bytes, the file has {size}")
    if size - end >= tables["vertex"][1].itemsize:
        raise FormatError(f"the header declares {end} bytes, but the file has {size}")
    low, high = _bounds(rows_of("chunk", 0, chunk.count), coloured)
    count, coefficients = vertex.count, (degree + 1) ** 2
    means, scales, quats = (np.empty((count, width), np.float32) for width in (3, 3, 4))
    opacities, colours = np.empty(count, np.float32), np.empty((count, coefficients, 3), np.float32)
    for at in range(0, count, _BLOCK):
        part = slice(at, min(at + _BLOCK, count))
        rows = rows_of("vertex", at, part.stop - at)
        chunks = np.arange(part.start, part.stop) // _CHUNK
        colour = _unpacked(rows["packed_color"], _FOUR)
        opacities[part] = colour[:, 3]
        with np.errstate(over="ignore", invalid="ignore"):
            thirds = [_unpacked(rows[PACKED], _THREE), _unpacked(rows["packed_scale"], _THREE), colour[:, :3]]
            between = np.hstack(thirds)
            values = low[chunks] * (1 - between) + high[chunks] * between
            means[part] = values[:, :3]
            scales[part] = np.exp(values[:, 3:6])
            colours[part, 0] = (values[:, 6:] - 0.5) / SH_C0
        others = (_unpacked(rows["packed_rotation"], _ROTATION)[:, 1:] - 0.5) * 2**0.5
        quats[part] = with_largest(_field(rows["packed_rotation"], _ROTATION, 0), others)
        if sh is not None and degree:
            codes = rows_of("sh", at, part.stop - at).view(np.uint8).reshape(part.stop - at, -1)
            codes = codes[:, [sh.names.index(f"f_rest_{i}") for i in range(3 * (coefficients - 1))]]
            colours[part, 1:] = _SH_VALUES[codes].reshape(-1, 3, coefficients - 1).transpose(0, 2, 1)
    return Splats(frozen(means), frozen(quats), frozen(scales), frozen(opacities), frozen(colours), header.antialias)


def _check_properties(chunk: Element, vertex: Element) -> bool:
    """Return whether the chunks have bounds of colours. Raises FormatError if properties are missing."""
    coloured = any(f"min_{name}" in chunk.properties for name in _COLOUR)
    named = (*_POSITION, *_SCALE, *(_COLOUR if coloured else ()))
    for name in (f"{end}_{name}" for end in ("min", "max") for name in named):
        if chunk.properties.get(name) not in ("f4", "f8"):
            raise FormatError(f"the chunks of a compressed PLY need a property float {name}")
    for name in _WORDS:
        if vertex.properties.get(name) != "u4":
            raise FormatError(f"the vertices of a compressed PLY need a property uint {name}")
    if chunk.count * _CHUNK < vertex.count:
        raise FormatError(f"{vertex.count} splats need {-(-vertex.count // _CHUNK)} chunks, found {chunk.count}")
    return coloured


def _check_harmonics(sh: Element | None, count: int) -> int:
    """Return the SH degree of the element sh. Raises FormatError when it does not fit the number of splats."""
    if sh is None:
        return 0
    if set(sh.properties.values()) - {"u1"}:
        raise FormatError("the element sh of a compressed PLY has properties of type uchar alone")
    if sh.count != count:
        raise FormatError(f"the element sh has {sh.count} rows for {count} splats")
    return sh_degree(sh)


def _bounds(rows: NDArray[np.void], coloured: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lower and upper bounds [C, 9] of positions, logarithms of scales, colours."""
    low, high = np.zeros((len(rows), 9)), np.ones((len(rows), 9))
    with np.errstate(invalid="ignore"):  # a NaN that signals
        for at, name in enumerate((*_POSITION, *_SCALE, *(_COLOUR if coloured else ()))):
            low[:, at], high[:, at] = rows[f"min_{name}"], rows[f"max_{name}"]
    return low, high


def _unpacked(words: NDArray[np.uint32], bits: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the fields [N, len(bits)] of words, 0 to 1."""
    return np.stack([_field(words, bits, at) / (2**wide - 1) for at, wide in enumerate(bits)], axis=1)


def _field(words: NDArray[np.uint32], bits: tuple[int, ...], at: int) -> NDArray[np.uint32]:
    """Return the integers in field ``at`` of words whose fields have ``bits``."""
    return words >> np.uint32(sum(bits[at + 1 :])) & np.uint32(2 ** bits[at] - 1)


def save_compressed_ply(splats: Splats, target: Source) -> None:
    """Write a compressed PLY with bounds of colours, the splats in Morton order; the same scene gives the same bytes.

    The module's text has the rounding. Splats that are never drawn (NaN, infinity, a zero quaternion) are left out.
    Opacities are clamped to 0 to 1, scales to 2e-9 to 5e8, SH coefficients above degree 0 to -4 to 4; a negative scale
    is written as its magnitude. Visibility cones are left out. Raises FormatError if ``target`` cannot be written.
    """
    replace_file(target, _packed(splats, _order(splats)))


def _order(splats: Splats) -> NDArray[np.intp]:
    """Return the indices of a file's splats, in its order."""
    kept = np.flatnonzero(splats.drawable())
    return kept[morton_order(splats.means[kept])]


def _packed(splats: Splats, order: NDArray[np.intp]) -> Iterator[bytes]:
    count, rest = len(order), 3 * (splats.sh.shape[1] - 1)
    bounds = [f"{end}_{name}" for names in (_POSITION, _SCALE, _COLOUR) for end in ("min", "max") for name in names]
    lines = ["ply", "format binary_little_endian 1.0", *([ANTIALIAS] if splats.antialias else [])]
    lines += [f"element chunk {-(-count // _CHUNK)}", *(f"property float {name}" for name in bounds)]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in _WORDS)]
    lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))] if rest else []
    yield "\n".join([*lines, "end_header", ""]).encode()
    blocks = [order[at : at + _BLOCK] for at in range(0, count, _BLOCK)]
    for block in blocks:
        low, high = _ends(_values(splats, block))
        yield np.stack([low, high], axis=2).reshape(len(low), -1).astype("<f4").tobytes()
    for block in blocks:
        yield _words(splats, block).astype("<u4").tobytes()
    for block in blocks if rest else []:
        values = splats.sh[block, 1:].transpose(0, 2, 1).reshape(len(block), -1).astype(np.float64)
        yield np.clip(np.floor((values / _SH_RANGE + 1) * 128), 0, 255).astype(np.uint8).tobytes()


def _values(splats: Splats, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the bounded values [N, 3, 3]: positions, logarithms of scales, colours."""
    with np.errstate(divide="ignore"):
        logarithms = np.log(np.abs(splats.scales[index].astype(np.float64)))
    clipped = np.clip(logarithms, -_LOG_LIMIT, _LOG_LIMIT)
    return np.stack([splats.means[index], clipped, splats.sh[index, 0].astype(np.float64) * SH_C0 + 0.5], axis=1)


def _ends(values: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the least and greatest value [C, 3, 3] of each chunk."""
    starts = np.arange(0, len(values), _CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    return low.astype(np.float32), high.astype(np.float32)


def _words(splats: Splats, index: NDArray[np.intp]) -> NDArray[np.uint32]:
    """Return the words [N, 4] in the order of _WORDS."""
    values = _values(splats, index)
    chunks = np.arange(len(index)) // _CHUNK
    low, high = (ends.astype(np.float64)[chunks] for ends in _ends(values))
    extent = high - low
    between = np.divide(values - low, extent, out=np.zeros_like(values), where=extent > 0)
    quats = splats.quats[index].astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    which, others = smallest_three(quats)
    rotation = np.hstack([which[:, None] / 3, others * 0.5**0.5 + 0.5])
    colour = np.hstack([between[:, 2], splats.opacities[index, None]])
    pairs = ((between[:, 0], _THREE), (rotation, _ROTATION), (between[:, 1], _THREE), (colour, _FOUR))
    return np.stack([_word(parts, bits) for parts, bits in pairs], axis=1)


def _word(parts: NDArray[np.floating], bits: tuple[int, ...]) -> NDArray[np.uint32]:
    """Return the words [N] of fields [N, len(bits)], clamped to 0 to 1."""
    word = np.zeros(len(parts), np.uint32)
    for at, wide in enumerate(bits):
        most = 2**wide - 1
        word = word << np.uint32(wide) | np.rint(np.clip(parts[:, at], 0, 1) * most).astype(np.uint32)
    return word


def _loses(scene: Splats | Avatar) -> Iterator[str]:
    splats = splats_of(scene)
    drawable = splats.drawable()
    if not drawable.all():
        yield f"{int((~drawable).sum())} splats with NaN, infinity or a zero quaternion, never drawn, are left out"
    yield "the splats are put into Morton order (neighbours in space are neighbours in the file)"
    yield from clamped_opacities(scene)
    yield from positive_scales(scene)
    with np.errstate(divide="ignore", invalid="ignore"):
        small = int((np.log(np.abs(splats.scales[drawable])) < -_LOG_LIMIT).any(axis=1).sum())
    if small:
        yield f"{small} splats with scales below 2e-9 m become that thick"
    bright = int((np.abs(splats.sh[drawable, 1:]) > _SH_RANGE).any(axis=(1, 2)).sum())
    if bright:
        yield f"spherical harmonics of {bright} splats are clamped to -4 to 4"


def _is_compressed(opened: Opened) -> bool:
    """Return whether a file is a PLY whose header declares packed positions."""
    if not is_ply(opened):
        return False
    head = opened.begin(_SNIFFED)
    header = head[: head.find(b"\nend_header") + 1]
    return re.search(rb"\nproperty[^\n]*[ \t]%b\s" % PACKED.encode(), header) is not None


COMPRESSED_PLY = Format(
    name="compressed-ply",
    title="compressed PLY",
    suffixes=(".compressed.ply",),
    sniff=_is_compressed,
    load=lambda opened: read_compressed_ply(opened.file, opened.size),
    save=lambda scene, target: save_compressed_ply(splats_of(scene), target),
    loses=_loses,
    order=_order,
)
