"""3DGS PLY: the files of INRIA's 3D Gaussian splatting and its many descendants, binary or ASCII.

A splat is a ``vertex`` with x y z, f_dc_0..2, f_rest_0..(0|9|24|45) channel-major (all red, all green, all blue),
opacity (logit), scale_0..2 (log) and rot_0..3 (wxyz), in any order and of any scalar type. Without scale_2 (2D
Gaussian splatting) they are flat; without f_dc, red green blue (bytes, or floats from 0 to 1) are their colours.
Normals, unknown properties and further elements are ignored.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import splats_of
from glsplat.errors import FormatError
from glsplat.formats.format import Format, Opened, clamped_opacities, positive_scales
from glsplat.io.files import Source, replace_file
from glsplat.optional import missing, plugin
from glsplat.splats import SH_C0, Splats, normalised

ANTIALIAS = "comment SplatRenderMode: mip"
"""Line of the header for Splats.antialias, as Brush and splat-transform write it."""

PACKED = "packed_position"
"""The property of the vertices by which a compressed PLY is known."""

_HEADER_LIMIT = 1 << 16  # bytes; a header of 3DGS has 1.5 kB
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}

_LINE_LIMIT = 1 << 16  # bytes of a line of ASCII; a splat of degree 3 has 800
_CHUNK = 1 << 15  # splats converted at a time: fits the cache and keeps the peak memory near the result's
_MEANS = ("x", "y", "z")
_QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
_SCALES = ("scale_0", "scale_1", "scale_2")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_RGB = ("red", "green", "blue")
_REQUIRED = (*_MEANS, *_DC, "opacity", *_SCALES, *_QUATS)
_LOGIT_LIMIT = 100.0  # sigmoid is 0 or 1 in float32 here
_LOG_ZERO = -120.0  # exp is 0 in float32 here


@dataclass(eq=False)
class Element:
    """A table of the file: ``count`` rows of the same properties."""

    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)  # name -> numpy type code
    lists: bool = False  # has a property of variable length

    @property
    def names(self) -> list[str]:
        """The properties in the file's order."""
        return list(self.properties)

    def dtype(self, order: str) -> np.dtype[np.void]:
        """Return the type of a row in a binary file of that byte order."""
        return np.dtype([(name, order + code) for name, code in self.properties.items()])


@dataclass(eq=False)
class PlyHeader:
    """What stands before the data."""

    order: str  # "<", ">", or "" for ASCII
    elements: list[Element]
    start: int  # where the data begins, bytes
    antialias: bool  # the splats want opacity compensation (Splats.antialias)

    def element(self, name: str) -> Element | None:
        """Return the first element of that name."""
        return next((element for element in self.elements if element.name == name), None)

    def before(self, element: Element) -> list[Element]:
        """Return the elements whose data come first."""
        return self.elements[: self.elements.index(element)]


def is_ply(opened: Opened) -> bool:
    """Return whether a file begins like a PLY."""
    return opened.head.startswith((b"ply\n", b"ply\r", b"ply "))


def read_ply(file: BinaryIO, size: int) -> Splats:
    """Read an open file of ``size`` bytes and activate its attributes: exp(scale), sigmoid(opacity), unit quaternions.

    The header is checked against the size before anything is allocated; values that are not finite are kept. Raises
    FormatError: no PLY, not of splats (names the missing properties), truncated, longer than its header says.
    """
    header = read_header(file)
    vertex = header.element("vertex")
    if vertex is None:
        raise FormatError(f"a splat PLY needs an element vertex, found {listed([e.name for e in header.elements])}")
    degree = _check_properties(vertex)
    if header.order and any(e.lists for e in header.before(vertex)):
        raise FormatError("an element with list properties before the vertices is not supported; put it behind them")
    file.seek(header.start)
    chunks = (_binary if header.order else _ascii)(file, size - header.start, header, vertex)
    return replace(_activate(chunks, vertex, degree), antialias=header.antialias)


def save_ply(splats: Splats, target: Source) -> None:
    """Write a binary little-endian 3DGS PLY; raises FormatError when ``target`` cannot be written.

    Opacities outside [0, 1] are clamped, a negative scale is written as its magnitude (the covariance is the same);
    0 and 1 become finite logits that read back as exactly 0 and 1, and a zero scale reads back as zero. ``antialias``
    becomes a comment in the header; visibility cones are left out.
    """
    rest = 3 * (splats.sh.shape[1] - 1)
    names = [*_MEANS, *_DC, *(f"f_rest_{i}" for i in range(rest)), "opacity", *_SCALES, *_QUATS]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(splats)}"]
    header[2:2] = [ANTIALIAS] if splats.antialias else []
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    replace_file(target, _packed("\n".join(header).encode(), splats))


def _packed(header: bytes, splats: Splats) -> Iterator[bytes | memoryview]:
    yield header
    for at in range(0, len(splats), _CHUNK):
        part = slice(at, at + _CHUNK)
        sh = splats.sh[part]
        with np.errstate(all="ignore"):
            opacity = splats.opacities[part, None].astype(np.float64)
            opacity = np.where(np.isfinite(opacity), np.clip(opacity, 0, 1), np.nan)  # infinite, it was never drawn
            logit = np.clip(np.log(opacity) - np.log1p(-opacity), -_LOGIT_LIMIT, _LOGIT_LIMIT)
            log = np.maximum(np.log(np.abs(splats.scales[part].astype(np.float64))), _LOG_ZERO)
            rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1)
            rows = np.hstack([splats.means[part], sh[:, 0], rest, logit, log, splats.quats[part]])
            yield rows.astype("<f4").tobytes()


def _check_properties(vertex: Element) -> int:
    """Return the SH degree of the vertices; FormatError when they are not splats."""
    have = vertex.properties
    if PACKED in have:
        hint = "glsplat.load reads it" if plugin("formats.rows") else missing("formats", "it")
        raise FormatError(f"this is a compressed PLY ({PACKED}), another format; {hint}")
    coloured = not any(name in have for name in _DC) and all(have.get(name) in ("u1", "f4", "f8") for name in _RGB)
    optional = (*(_DC if coloured else ()), _SCALES[2])
    lacking = [name for name in _REQUIRED if name not in have]
    if any(name not in optional for name in lacking):
        raise FormatError(f"a PLY, but not of Gaussian splats: its vertices lack {listed(lacking)}")
    if vertex.lists:
        raise FormatError("the vertices have a list property, which splats cannot have")
    return sh_degree(vertex)


def _binary(
    file: BinaryIO, available: int, header: PlyHeader, vertex: Element
) -> Iterator[dict[str, NDArray[np.generic]]]:
    """Yield the columns of the vertices, a chunk at a time.

    Reading takes less memory than mapping, and a file that shrinks meanwhile is an error, not a bus error.
    """
    dtype = vertex.dtype(header.order)
    available -= (skip := sum(e.count * e.dtype(header.order).itemsize for e in header.before(vertex)))
    if vertex.count * dtype.itemsize > max(available, 0):
        held = max(available, 0) // dtype.itemsize
        raise FormatError(f"truncated: the header declares {vertex.count} splats, the file holds {held}")
    if header.elements[-1] is vertex and available - vertex.count * dtype.itemsize >= dtype.itemsize:
        held = available // dtype.itemsize
        raise FormatError(f"the header declares {vertex.count} splats, but the file holds {held}")
    file.seek(skip, 1)
    for at in range(0, vertex.count, _CHUNK):
        rows = np.empty(min(_CHUNK, vertex.count - at), dtype)
        if file.readinto(rows.view(np.uint8).data) != rows.nbytes:  # type: ignore[attr-defined]
            raise FormatError("the file became shorter while it was read")
        yield {name: rows[name] for name in vertex.names}


def _ascii(
    file: BinaryIO, available: int, header: PlyHeader, vertex: Element
) -> Iterator[dict[str, NDArray[np.generic]]]:
    width = len(vertex.properties)
    # a value takes at least a digit and a separator
    if 2 * width * vertex.count > available + 1:
        raise FormatError(
            f"truncated: the header declares {vertex.count} splats, the file has {available} bytes for them"
        )
    lines = _lines(file)
    for element in header.before(vertex):
        if element.count > available or sum(1 for _ in islice(lines, element.count)) != element.count:
            raise FormatError(f"truncated: fewer than {element.count} lines of element {element.name[:40]!r}")
    for at in range(0, vertex.count, _CHUNK):
        count = min(_CHUNK, vertex.count - at)
        rows = [line.split() for line in islice(lines, count)]
        if len(rows) != count:
            raise FormatError(f"truncated: the header declares {vertex.count} splats, the file holds {at + len(rows)}")
        wrong = next((i for i, row in enumerate(rows) if len(row) != width), None)
        if wrong is not None:
            raise FormatError(f"splat {at + wrong} needs {width} values, found {len(rows[wrong])}")
        try:
            table = np.fromiter((float(value) for row in rows for value in row), np.float64, count * width)
        except ValueError as error:
            raise FormatError(f"splats {at} to {at + count - 1}: {str(error)[:80]}") from None
        yield dict(zip(vertex.names, table.reshape(count, width).T, strict=True))
    if header.elements[-1] is vertex and next(lines, None) is not None:
        raise FormatError(f"the header declares {vertex.count} splats, but the file holds more")


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Yield lines that are not blank. A hole in a file is a line without an end: it is not read to its end."""
    while line := file.readline(_LINE_LIMIT):
        if len(line) == _LINE_LIMIT and not line.endswith(b"\n"):
            raise FormatError(f"a line of a splat has more than {_LINE_LIMIT} bytes; is this an ASCII PLY?")
        if not line.isspace():
            yield line


def _activate(chunks: Iterator[dict[str, NDArray[np.generic]]], vertex: Element, degree: int) -> Splats:
    coefficients = (degree + 1) ** 2
    first = list(islice(chunks, 1))  # checks the count against the file's size, so the arrays may be allocated
    count, at = vertex.count, 0
    means, scales, quats = (np.empty((count, width), np.float32) for width in (3, 3, 4))
    opacities, sh = np.empty(count, np.float32), np.empty((count, coefficients, 3), np.float32)
    for columns in chain(first, chunks):
        part = slice(at, at := at + len(columns["x"]))
        with np.errstate(over="ignore", invalid="ignore"):
            _gather(means[part], columns, _MEANS)
            _gather(quats[part], columns, _QUATS)
            quats[part] = normalised(quats[part])
            scales[part, 2] = -np.inf  # flat, where there is no third
            _gather(scales[part], columns, [name for name in _SCALES if name in columns])
            np.exp(scales[part], out=scales[part])
            opacity = opacities[part]
            np.exp(-columns["opacity"].astype(np.float32), out=opacity)
            np.divide(1, 1 + opacity, out=opacity)  # exp(1e4) = inf gives 0, not NaN
            if _DC[0] in columns:
                _gather(sh[part, 0], columns, _DC)
            else:
                _gather(sh[part, 0], columns, _RGB)
                sh[part, 0] /= [255 if vertex.properties[name] == "u1" else 1 for name in _RGB]
                sh[part, 0] = (sh[part, 0] - np.float32(0.5)) / np.float32(SH_C0)
            for channel in range(3):
                base = channel * (coefficients - 1)
                _gather(sh[part, 1:, channel], columns, [f"f_rest_{base + i}" for i in range(coefficients - 1)])
    return Splats(frozen(means), frozen(quats), frozen(scales), frozen(opacities), frozen(sh))


def _gather(
    out: NDArray[np.float32], columns: dict[str, NDArray[np.generic]], names: list[str] | tuple[str, ...]
) -> None:
    for i, name in enumerate(names):
        out[:, i] = columns[name]


def read_header(file: BinaryIO) -> PlyHeader:
    """Read the header at the start of an open file. Raises FormatError for what is no PLY."""
    file.seek(0)
    head = file.read(_HEADER_LIMIT)
    if not re.match(rb"ply[ \t]*\r?\n", head):
        raise FormatError('not a PLY file (it does not start with the line "ply")')
    end = re.search(rb"\nend_header[ \t]*\r?\n", head)
    if end is None:
        raise FormatError(f'the PLY header has no line "end_header" in its first {min(len(head), _HEADER_LIMIT)} bytes')
    order: str | None = None
    elements: list[Element] = []
    antialias = False
    # comments may hold any bytes, and latin-1 never fails
    for line in head[: end.start()].decode("latin-1").split("\n")[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            antialias = _antialias(words[1:], antialias)
        elif words[0] == "format" and len(words) == 3 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,18}", words[2]):
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in _TYPES:
            if words[2] in elements[-1].properties:
                raise FormatError(f"the PLY header declares {words[2][:40]!r} twice")
            elements[-1].properties[words[2]] = _TYPES[words[1]]
        elif words[:2] == ["property", "list"] and elements and len(words) == 5:
            elements[-1].lists = True
        else:
            raise FormatError(f"the PLY header has a line that cannot be understood: {line[:60]!r}")
    if order is None:
        raise FormatError("the PLY header has no format line (binary_little_endian, binary_big_endian or ascii)")
    return PlyHeader(order, elements, end.end(), antialias)


def sh_degree(element: Element) -> int:
    """Return the degree of the spherical harmonics, by the number of properties f_rest_0, f_rest_1, ..."""
    rest = sum(re.fullmatch("f_rest_[0-9]+", name) is not None for name in element.properties)
    if rest not in (0, 9, 24, 45) or any(f"f_rest_{i}" not in element.properties for i in range(rest)):
        raise FormatError(f"a splat PLY needs 0, 9, 24 or 45 properties f_rest_0, f_rest_1, ...; found {rest}")
    return (0, 9, 24, 45).index(rest)


def listed(names: list[str]) -> str:
    """Return names of a header as one line for a message."""
    shown = [name[:40] for name in names]
    return ", ".join(shown[:12]) + (", ..." if len(shown) > 12 else "") or "nothing"


def _antialias(comment: list[str], before: bool) -> bool:
    """Return the antialias flag of a comment of Brush, Postshot or older glsplat files; the last one counts."""
    match [word.lower() for word in comment]:
        case ["splatrendermode:", mode]:
            return mode == "mip"
        case ["antialiased", flag]:
            return flag == "1"
        case ["glsplat", "antialias"]:
            return True
    return before


PLY = Format(
    name="ply",
    title="3DGS PLY",
    suffixes=(".ply",),
    sniff=is_ply,
    load=lambda start: read_ply(start.file, start.size),
    save=lambda scene, target: save_ply(splats_of(scene), target),
    loses=lambda scene: chain(clamped_opacities(scene), positive_scales(scene)),
)


def add_formats(formats: dict[str, Format]) -> None:
    """Add 3DGS PLY to the registry."""
    formats[PLY.name] = PLY
