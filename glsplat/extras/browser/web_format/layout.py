"""Layout of an avatar's file for browsers: its header, and the unpacked size of each part."""

from __future__ import annotations

import struct
from typing import Literal

import msgspec

MAGIC = b"GSAV"
VERSION = 1
HEAD = struct.Struct("<4sHHII")
"""Magic, version, 0, bytes of the packed header, bytes of the unpacked header."""

MOST_HEADER = 1 << 20  # bytes of JSON
MOST_SPLATS = 1 << 21  # a part
MOST_ENTRIES = 1 << 24  # of shapes, a part
MOST_JOINTS = 4096
_SHORT = 256  # joints that one byte can index


class Joints(msgspec.Struct):
    """The skeleton, with the matrices of ``glsplat.Skeleton`` as 3x4, row by row."""

    names: list[str]
    parents: list[int]
    rest: list[float]
    inverse_bind: list[float]


class Targets(msgspec.Struct):
    """Names, sizes and limits of the shapes (``glsplat.skinning.shapes.Shapes``)."""

    names: list[str]
    sizes: list[float]
    limits: list[float]


class Part(msgspec.Struct, omit_defaults=True):
    """A separately packed part: a level's splats, shapes or surface. ``offset`` is from the header's end."""

    kind: Literal["splats", "shapes", "surface"]
    level: int
    offset: int
    bytes: int
    splats: int = 0
    entries: int = 0
    density: float | None = None
    psnr: float | None = None
    low: list[float] = []
    high: list[float] = []
    scales: list[float] = []
    colours: list[float] = []
    sh: list[float] = []
    shaded: bool = False


class Header(msgspec.Struct):
    """Header of the file. ``splats`` is the count of level 0."""

    splats: int
    sh_degree: int
    influences: int
    antialias: bool
    joints: Joints
    shapes: Targets | None
    parts: list[Part]


def planes_of(header: Header) -> dict[str, int]:
    """Return the bytes a splat of each attribute, in the order of a part."""
    wide = 1 if len(header.joints.names) <= _SHORT else 2
    return {
        "means": 6,
        "quats": 4,
        "scales": 3,
        "opacities": 1,
        "colours": 3,
        "sh": 3 * ((header.sh_degree + 1) ** 2 - 1),
        "joints": wide * header.influences,
        "weights": 2 * (header.influences - 1),
    }


def unpacked_size(header: Header, part: Part, splats: int) -> int:
    """Return the unpacked bytes of a part of a level of ``splats``."""
    if part.kind == "splats":
        return splats * sum(planes_of(header).values())
    if part.kind == "surface":
        return splats * (7 if part.shaded else 4)
    return 2 * splats + 13 * part.entries
