"""The header of a PLY: byte order, elements, and what its comments say of the splats."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from glsplat.errors import FormatError
from glsplat.formats.format import Opened

__all__ = ["ANTIALIAS", "Element", "PlyHeader", "is_compressed", "is_ply", "listed", "read_header", "sh_degree"]

ANTIALIAS = "comment SplatRenderMode: mip"
"""What Splats.antialias becomes in a header, spelled as Brush and splat-transform do."""

PACKED = "packed_position"
"""The property of the vertices by which a compressed PLY is known."""

_LIMIT = 1 << 16  # bytes; a header of 3DGS has 1.5 kB
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}


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
        """A row in a binary file of that byte order."""
        return np.dtype([(name, order + code) for name, code in self.properties.items()])


@dataclass(eq=False)
class PlyHeader:
    """What stands before the data."""

    order: str  # "<", ">", or "" for ASCII
    elements: list[Element]
    start: int  # where the data begins, bytes
    antialias: bool  # the splats want opacity compensation (Splats.antialias)

    def element(self, name: str) -> Element | None:
        """The first element of that name."""
        return next((element for element in self.elements if element.name == name), None)

    def before(self, element: Element) -> list[Element]:
        """The elements whose data come first."""
        return self.elements[: self.elements.index(element)]


def is_ply(opened: Opened) -> bool:
    """Whether a file begins like a PLY."""
    return opened.head.startswith((b"ply\n", b"ply\r", b"ply "))


def is_compressed(opened: Opened) -> bool:
    """Whether it is a PLY whose header declares packed positions."""
    if not is_ply(opened):
        return False
    head = opened.begin(_LIMIT)
    header = head[: head.find(b"\nend_header") + 1]
    return re.search(rb"\nproperty[^\n]*[ \t]%b\s" % PACKED.encode(), header) is not None


def read_header(file: BinaryIO) -> PlyHeader:
    """The header at the start of an open file. Raises FormatError for what is no PLY."""
    file.seek(0)
    head = file.read(_LIMIT)
    if not re.match(rb"ply[ \t]*\r?\n", head):
        raise FormatError('not a PLY file (it does not start with the line "ply")')
    end = re.search(rb"\nend_header[ \t]*\r?\n", head)
    if end is None:
        raise FormatError(f'the PLY header has no line "end_header" in its first {min(len(head), _LIMIT)} bytes')
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
    """Degree of the spherical harmonics, by the number of properties f_rest_0, f_rest_1, ..."""
    rest = sum(re.fullmatch("f_rest_[0-9]+", name) is not None for name in element.properties)
    if rest not in (0, 9, 24, 45) or any(f"f_rest_{i}" not in element.properties for i in range(rest)):
        raise FormatError(f"a splat PLY needs 0, 9, 24 or 45 properties f_rest_0, f_rest_1, ...; found {rest}")
    return (0, 9, 24, 45).index(rest)


def listed(names: list[str]) -> str:
    """Names of a stranger's header for a message of one line."""
    shown = [name[:40] for name in names]
    return ", ".join(shown[:12]) + (", ..." if len(shown) > 12 else "") or "nothing"


def _antialias(comment: list[str], before: bool) -> bool:
    """What a comment says: of Brush, of Postshot, of older files of this house; the last one counts."""
    match [word.lower() for word in comment]:
        case ["splatrendermode:", mode]:
            return mode == "mip"
        case ["antialiased", flag]:
            return flag == "1"
        case ["glsplat", "antialias"]:
            return True
    return before
