"""Read an avatar from its file for browsers, for tests and as the reference of the page's reader.

Counts of the header are checked against limits, and no part is unpacked beyond them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, PoseError
from glsplat.extras.browser.web_format.planes import (
    WEIGHT,
    colours_of,
    from_planes,
    means_of,
    quats_of,
    running,
    scales_of,
)
from glsplat.light.surface import Surface
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import INFLUENCES, Skin
from glsplat.splats import Level, Splats

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


_MOST_PARTS = 64
_FARTHEST = 1e6  # of any number of a box, in metres
_LOGS = 30.0  # of a scale
_LONGEST = 64  # characters of a joint's name

_decoder = msgspec.json.Decoder(Header)


def decode_avatar(data: bytes) -> Avatar:
    """Return the avatar of a file, with its levels. Raises FormatError for other, truncated or inconsistent files."""
    header, first = read_header(data)
    body = memoryview(data)[first:]
    try:
        skeleton = Skeleton(
            header.joints.names,
            header.joints.parents,
            _matrices(header.joints.rest),
            _matrices(header.joints.inverse_bind),
        )
        bodies = {part.level: part for part in header.parts if part.kind == "splats"}
        more: dict[tuple[str, int], Part] = {(part.kind, part.level): part for part in header.parts}
        made = {number: _avatar(body, header, part, more, skeleton) for number, part in sorted(bodies.items())}
        levels = [
            Level(avatar, bodies[number].density or 0.0, bodies[number].psnr)
            for number, avatar in made.items()
            if number
        ]
        whole = made[0]
        return Avatar(whole.splats, skeleton, whole.skin, {}, tuple(levels), whole.shapes)
    except PoseError as error:
        raise FormatError(f"the skeleton cannot be used: {error}") from None


def read_header(data: bytes) -> tuple[Header, int]:
    """Return the header, checked against limits and the file's size, and the offset of the parts.

    Raises FormatError.
    """
    if len(data) < HEAD.size or data[:4] != MAGIC:
        raise FormatError("expected an avatar's file for browsers (GSAV), found something else")
    _, version, _, packed, size = HEAD.unpack_from(data)
    if version != VERSION:
        raise FormatError(f"an avatar's file for browsers of version {version}, this reads {VERSION}")
    if not 0 < size <= MOST_HEADER:
        raise FormatError(f"the header says {size} bytes, at most {MOST_HEADER} are read")
    text = _unpacked(data, HEAD.size, packed, size, "the header")
    try:
        header = _decoder.decode(text)
    except (msgspec.MsgspecError, RecursionError, UnicodeError):
        raise FormatError("the header is not valid JSON of this format") from None
    _check(header, len(data) - HEAD.size - packed)
    return header, HEAD.size + packed


def _check(header: Header, size: int) -> None:
    joints = header.joints
    count = len(joints.names)
    if not (0 <= header.sh_degree <= 3 and header.influences in INFLUENCES and 0 < count <= MOST_JOINTS):
        raise FormatError(f"expected SH degree 0 to 3, 1, 2, 4 or 8 joints a splat and 1 to {MOST_JOINTS} joints")
    if not (len(joints.parents) == count and len(joints.rest) == len(joints.inverse_bind) == 12 * count):
        raise FormatError(f"{count} joints need as many parents, and 12 numbers each for both matrices")
    if any(not 0 < len(name) <= _LONGEST for name in joints.names):
        raise FormatError(f"a joint's name needs 1 to {_LONGEST} characters")
    seen, levels = set(), sorted(part.level for part in header.parts if part.kind == "splats")
    if not 0 < len(header.parts) <= _MOST_PARTS or levels != list(range(len(levels))):
        raise FormatError("expected the splats of each level once, those of level 0 among them")
    for part in header.parts:
        if (part.kind, part.level) in seen or part.level not in levels:
            raise FormatError(f"the {part.kind} of level {part.level} come twice, or have no level")
        seen.add((part.kind, part.level))
        if not (0 <= part.offset and 0 < part.bytes and part.offset + part.bytes <= size):
            raise FormatError(f"the {part.kind} of level {part.level} are not within the file's {size} bytes")
        if part.kind == "splats":
            _check_splats(header, part)
        elif part.kind == "shapes" and (header.shapes is None or not 0 < part.entries <= MOST_ENTRIES):
            raise FormatError(f"expected 1 to {MOST_ENTRIES} entries of named shapes, found {part.entries}")


def _check_splats(header: Header, part: Part) -> None:
    if not 0 < part.splats <= MOST_SPLATS:
        raise FormatError(f"level {part.level} says {part.splats} splats, 1 to {MOST_SPLATS} are read")
    lengths = (len(part.low), len(part.high), len(part.scales), len(part.colours), len(part.sh))
    if lengths != (3, 3, 2, 6, header.sh_degree):
        raise FormatError(f"level {part.level} needs 3, 3, 2, 6 and {header.sh_degree} numbers, not {lengths}")
    box, colours = (*part.low, *part.high), (*part.colours, *part.sh)
    ordered = all(low <= high for low, high in zip(part.low, part.high, strict=True))
    if not (ordered and max(map(abs, (*box, *colours))) <= _FARTHEST and max(map(abs, part.scales)) <= _LOGS):
        raise FormatError(f"level {part.level}: its box, scales or colours are out of bounds")


def _avatar(
    data: memoryview, header: Header, part: Part, more: Mapping[tuple[str, int], Part], skeleton: Skeleton
) -> Avatar:
    n, what = part.splats, f"level {part.level}"
    face, laid = more.get(("shapes", part.level)), more.get(("surface", part.level))
    raw = _unpacked(data, part.offset, part.bytes, unpacked_size(header, part, n), what)
    planes, at = {}, 0
    for name, width in planes_of(header).items():
        planes[name] = raw[at : at + width * n]
        at += width * n
    low, high = np.array(part.low), np.array(part.high)
    sh = np.zeros((n, (header.sh_degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = colours_of(
        from_planes(planes["colours"], n, "u1"), np.array(part.colours[:3]), np.array(part.colours[3:])
    )
    if header.sh_degree:
        steps = [most / 127 for band, most in enumerate(part.sh, 1) for _ in range(2 * band + 1)]
        rest = from_planes(planes["sh"], n, "i1").reshape(n, -1, 3)
        sh[:, 1:] = rest * np.array(steps)[:, None]
    splats = Splats(
        means_of(from_planes(planes["means"], n, "<u2"), low, high),
        quats_of(from_planes(planes["quats"], n, "<u4")[:, 0]),
        scales_of(from_planes(planes["scales"], n, "u1"), (part.scales[0], part.scales[1])),
        (from_planes(planes["opacities"], n, "u1")[:, 0] / 255).astype(np.float32),
        sh,
        header.antialias,
        surface=None if laid is None else _surface(data, header, laid, n),
    )
    weights = np.zeros((n, header.influences), np.int64)
    weights[:, 1:] = from_planes(planes["weights"], n, "<u2").reshape(n, -1)
    weights[:, 0] = WEIGHT - weights.sum(axis=1)
    if (weights < 0).any():
        raise FormatError(f"{what}: the weights of a splat are more than one")
    joints = from_planes(planes["joints"], n, "u1" if len(skeleton) <= 256 else "<u2")
    shapes = None if face is None else _shapes(data, header, face, n)
    return Avatar(splats, skeleton, Skin(joints, weights / WEIGHT), shapes=shapes)


def _shapes(data: memoryview, header: Header, part: Part, splats: int) -> Shapes:
    assert header.shapes is not None
    size = unpacked_size(header, part, splats)
    raw = _unpacked(data, part.offset, part.bytes, size, f"the shapes of level {part.level}")
    count = part.entries
    each = from_planes(raw[: 2 * splats], splats, "<u2")[:, 0]
    starts = np.concatenate([[0], np.cumsum(each, dtype=np.int64)])
    at = 2 * splats
    targets = from_planes(raw[at : at + count], count, "u1")[:, 0]
    moves = from_planes(raw[at + count : at + 7 * count], count, "<i2")
    bends = from_planes(raw[at + 7 * count :], count, "i1").reshape(count, 2, 3)
    known = header.shapes
    limits = np.array(known.limits, np.float32).reshape(-1, 2) if len(known.limits) % 2 == 0 else np.zeros((0, 2))
    return Shapes(known.names, starts, targets, moves, bends, known.sizes, limits)


def _surface(data: memoryview, header: Header, part: Part, splats: int) -> Surface:
    size = unpacked_size(header, part, splats)
    raw = _unpacked(data, part.offset, part.bytes, size, f"the surface of level {part.level}")
    steps = running(from_planes(raw, splats, "u1")).astype(np.uint8)
    return Surface(steps[:, :3].view(np.int8), steps[:, 3], steps[:, 4:] if part.shaded else None)


def _matrices(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Return matrices [J, 4, 4] from rows of 3x4."""
    out = np.tile(np.eye(4), (len(numbers) // 12, 1, 1))
    out[:, :3] = np.array(numbers, np.float64).reshape(-1, 3, 4)
    return out


def _unpacked(data: bytes | memoryview, start: int, length: int, size: int, what: str) -> bytes:
    """Unpack exactly ``size`` bytes. Raises FormatError for more or fewer."""
    unpacker = zlib.decompressobj(-15)
    try:
        raw = unpacker.decompress(data[start : start + length], size + 1)
    except zlib.error:
        raise FormatError(f"{what} cannot be unpacked") from None
    if len(raw) != size or not unpacker.eof or unpacker.unused_data:
        raise FormatError(f"{what} needs {size} bytes unpacked, found {'more' if len(raw) > size else len(raw)}")
    return raw
