"""3DGS PLY: the files of INRIA's 3D Gaussian splatting and its many descendants, binary or ASCII.

A splat is a ``vertex`` with x y z, f_dc_0..2, f_rest_0..(0|9|24|45) channel-major (all red, all green, all blue),
opacity (logit), scale_0..2 (log) and rot_0..3 (wxyz), in any order and of any scalar type. Normals, unknown
properties and further elements are ignored.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.files import Source, checked, naming, open_regular, replace_file
from glsplat.formats.format import Format, clamped_opacities
from glsplat.splats import Splats, normalised
from glsplat.views import splats_of

__all__ = ["PLY", "load_ply", "read_ply", "save_ply"]

_HEADER_LIMIT = 1 << 16  # bytes; a header of 3DGS has 1.5 kB
_LINE_LIMIT = 1 << 16  # bytes of a line of ASCII; a splat of degree 3 has 800
_CHUNK = 1 << 15  # splats converted at a time: fits the cache and keeps the peak memory near the result's
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_MEANS = ("x", "y", "z")
_QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")
_SCALES = ("scale_0", "scale_1", "scale_2")
_DC = ("f_dc_0", "f_dc_1", "f_dc_2")
_REQUIRED = (*_MEANS, *_DC, "opacity", *_SCALES, *_QUATS)
_LOGIT_LIMIT = 100.0  # sigmoid is 0 or 1 in float32 here
_ANTIALIAS = "comment glsplat antialias"  # Splats.antialias; no convention of 3DGS has a place for it
_LOG_ZERO = -120.0  # exp is 0 in float32 here


@dataclass
class _Element:
    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)  # name -> numpy type code
    lists: bool = False  # has a property of variable length

    @property
    def names(self) -> list[str]:
        return list(self.properties)

    def dtype(self, order: str) -> np.dtype[np.void]:
        return np.dtype([(name, order + code) for name, code in self.properties.items()])


def load_ply(source: Source, *, strict: bool = False) -> Splats:
    """Read a 3DGS PLY and activate its attributes: exp(scale), sigmoid(opacity), unit quaternions wxyz.

    The header is checked against the size of the file before anything is allocated. Non-finite values are kept,
    or with ``strict`` refused. Raises FormatError: no PLY, a PLY of something else than splats (names the missing
    properties), truncated, or longer than its header says.
    """
    with naming(source), open_regular(source) as (file, size):
        return checked(read_ply(file, size), source, strict)


def read_ply(file: BinaryIO, size: int) -> Splats:
    """The splats of an open file of ``size`` bytes."""
    head = file.read(_HEADER_LIMIT)
    order, elements, start = _header(head)
    antialias = _ANTIALIAS.encode() in head[:start].splitlines()
    vertex = next((e for e in elements if e.name == "vertex"), None)
    if vertex is None:
        raise FormatError(f"a splat PLY needs an element vertex, found {_listed([e.name for e in elements])}")
    degree = _check_properties(vertex)
    before = elements[: elements.index(vertex)]
    if any(e.lists for e in before):
        raise FormatError("an element with list properties before the vertices is not supported; put it behind them")
    last = elements[-1] is vertex
    file.seek(start)
    if order:
        chunks = _binary(file, size - start, before, vertex, order, last)
    else:
        chunks = _ascii(file, size - start, before, vertex, last)
    return replace(_activate(chunks, vertex.count, degree), antialias=antialias)


def save_ply(splats: Splats, target: Source) -> None:
    """Write a binary little-endian 3DGS PLY; raises FormatError when ``target`` cannot be written.

    Opacities outside [0, 1] are clamped, a negative scale is written as its magnitude (the covariance is the same);
    0 and 1 become finite logits that read back as exactly 0 and 1, and a zero scale reads back as zero. ``antialias``
    becomes a comment in the header; visibility cones are left out.
    """
    rest = 3 * (splats.sh.shape[1] - 1)
    names = [*_MEANS, *_DC, *(f"f_rest_{i}" for i in range(rest)), "opacity", *_SCALES, *_QUATS]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(splats)}"]
    header[2:2] = [_ANTIALIAS] if splats.antialias else []
    header += [f"property float {name}" for name in names] + ["end_header", ""]
    replace_file(target, _packed("\n".join(header).encode(), splats))


def _packed(header: bytes, splats: Splats) -> Iterator[bytes | memoryview]:
    yield header
    for at in range(0, len(splats), _CHUNK):
        part = slice(at, at + _CHUNK)
        sh = splats.sh[part]
        with np.errstate(all="ignore"):
            opacity = np.clip(splats.opacities[part, None].astype(np.float64), 0, 1)
            logit = np.clip(np.log(opacity) - np.log1p(-opacity), -_LOGIT_LIMIT, _LOGIT_LIMIT)
            log = np.maximum(np.log(np.abs(splats.scales[part].astype(np.float64))), _LOG_ZERO)
            rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(sh), -1)
            rows = np.hstack([splats.means[part], sh[:, 0], rest, logit, log, splats.quats[part]])
            yield rows.astype("<f4").tobytes()


def _header(head: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for ASCII), the elements, and where the data starts."""
    if not re.match(rb"ply[ \t]*\r?\n", head):
        raise FormatError('not a PLY file (it does not start with the line "ply")')
    end = re.search(rb"\nend_header[ \t]*\r?\n", head)
    if end is None:
        raise FormatError(f'the PLY header has no line "end_header" in its first {min(len(head), _HEADER_LIMIT)} bytes')
    order: str | None = None
    elements: list[_Element] = []
    # comments may hold any bytes, and latin-1 never fails
    for line in head[: end.start()].decode("latin-1").split("\n")[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and re.fullmatch("[0-9]{1,18}", words[2]):
            elements.append(_Element(words[1], int(words[2])))
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
    return order, elements, end.end()


def _check_properties(vertex: _Element) -> int:
    """SH degree of the vertices; FormatError when they are not splats."""
    have = vertex.properties
    missing = [name for name in _REQUIRED if name not in have]
    if "packed_position" in have:
        raise FormatError("this is a compressed PLY (packed_position); convert it to a plain 3DGS PLY first")
    if missing:
        raise FormatError(f"a PLY, but not of Gaussian splats: its vertices lack {_listed(missing)}")
    if vertex.lists:
        raise FormatError("the vertices have a list property, which splats cannot have")
    rest = sum(re.fullmatch("f_rest_[0-9]+", name) is not None for name in have)
    if rest not in (0, 9, 24, 45) or any(f"f_rest_{i}" not in have for i in range(rest)):
        raise FormatError(f"a splat PLY needs 0, 9, 24 or 45 properties f_rest_0, f_rest_1, ...; found {rest}")
    return (0, 9, 24, 45).index(rest)


def _binary(
    file: BinaryIO, available: int, before: list[_Element], vertex: _Element, order: str, last: bool
) -> Iterator[dict[str, NDArray[np.generic]]]:
    """Columns of the vertices, a chunk at a time. Reading costs less memory than mapping, and a file that shrinks
    meanwhile is an error here, not a bus error."""
    dtype = vertex.dtype(order)
    available -= (skip := sum(e.count * e.dtype(order).itemsize for e in before))
    if vertex.count * dtype.itemsize > max(available, 0):
        held = max(available, 0) // dtype.itemsize
        raise FormatError(f"truncated: the header declares {vertex.count} splats, the file holds {held}")
    if last and available - vertex.count * dtype.itemsize >= dtype.itemsize:
        held = available // dtype.itemsize
        raise FormatError(f"the header declares {vertex.count} splats, but the file holds {held}")
    file.seek(skip, 1)
    for at in range(0, vertex.count, _CHUNK):
        rows = np.empty(min(_CHUNK, vertex.count - at), dtype)
        if file.readinto(rows.view(np.uint8).data) != rows.nbytes:  # type: ignore[attr-defined]
            raise FormatError("the file became shorter while it was read")
        yield {name: rows[name] for name in vertex.names}


def _ascii(
    file: BinaryIO, available: int, before: list[_Element], vertex: _Element, last: bool
) -> Iterator[dict[str, NDArray[np.generic]]]:
    width = len(vertex.properties)
    # a value takes at least a digit and a separator
    if 2 * width * vertex.count > available + 1:
        raise FormatError(
            f"truncated: the header declares {vertex.count} splats, the file has {available} bytes for them"
        )
    lines = _lines(file)
    for element in before:
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
    if last and next(lines, None) is not None:
        raise FormatError(f"the header declares {vertex.count} splats, but the file holds more")


def _lines(file: BinaryIO) -> Iterator[bytes]:
    """Lines that are not blank. A hole in a file is a line without an end: it is not read to its end."""
    while line := file.readline(_LINE_LIMIT):
        if len(line) == _LINE_LIMIT and not line.endswith(b"\n"):
            raise FormatError(f"a line of a splat has more than {_LINE_LIMIT} bytes; is this an ASCII PLY?")
        if not line.isspace():
            yield line


def _activate(chunks: Iterator[dict[str, NDArray[np.generic]]], count: int, degree: int) -> Splats:
    coefficients = (degree + 1) ** 2
    out: _Columns | None = None
    at = 0
    for columns in chunks:  # the first chunk has been checked against the file, so the arrays may be allocated
        if out is None:
            out = _empty(count, coefficients)
        part = slice(at, at := at + len(columns["x"]))
        with np.errstate(over="ignore", invalid="ignore"):
            _gather(out.means[part], columns, _MEANS)
            quats = np.empty_like(out.quats[part])
            _gather(quats, columns, _QUATS)
            out.quats[part] = normalised(quats)
            _gather(out.scales[part], columns, _SCALES)
            np.exp(out.scales[part], out=out.scales[part])
            opacity = out.opacities[part]
            np.exp(-columns["opacity"].astype(np.float32), out=opacity)
            np.divide(1, 1 + opacity, out=opacity)  # exp(1e4) = inf gives 0, not NaN
            _gather(out.sh[part, 0], columns, _DC)
            for channel in range(3):
                base = channel * (coefficients - 1)
                rest = [f"f_rest_{base + i}" for i in range(coefficients - 1)]
                _gather(out.sh[part, 1:, channel], columns, rest)
    out = out or _empty(0, coefficients)
    return Splats(frozen(out.means), frozen(out.quats), frozen(out.scales), frozen(out.opacities), frozen(out.sh))


def _gather(
    out: NDArray[np.float32], columns: dict[str, NDArray[np.generic]], names: list[str] | tuple[str, ...]
) -> None:
    for i, name in enumerate(names):
        out[:, i] = columns[name]


@dataclass
class _Columns:
    """The arrays of Splats while they are filled."""

    means: NDArray[np.float32]
    quats: NDArray[np.float32]
    scales: NDArray[np.float32]
    opacities: NDArray[np.float32]
    sh: NDArray[np.float32]


def _empty(count: int, coefficients: int) -> _Columns:
    means, scales, quats = (np.empty((count, width), np.float32) for width in (3, 3, 4))
    return _Columns(means, quats, scales, np.empty(count, np.float32), np.empty((count, coefficients, 3), np.float32))


def _listed(names: list[str]) -> str:
    shown = [name[:40] for name in names]
    return ", ".join(shown[:12]) + (", ..." if len(shown) > 12 else "") or "nothing"


def _loses(scene: Splats | Avatar) -> Iterator[str]:
    yield from clamped_opacities(scene)
    with np.errstate(invalid="ignore"):
        negative = int((splats_of(scene).scales < 0).any(axis=1).sum())
    if negative:
        yield f"{negative} splats with negative scales are written with positive ones (their shape is the same)"


PLY = Format(
    name="ply",
    title="3DGS PLY",
    suffixes=(".ply",),
    sniff=lambda start: start.head.startswith((b"ply\n", b"ply\r", b"ply ")),
    load=lambda file, size, _: read_ply(file, size),
    save=lambda scene, target: save_ply(splats_of(scene), target),
    loses=_loses,
)
