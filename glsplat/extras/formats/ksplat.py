"""KSPLAT: the files of mkkellogg's GaussianSplats3D, compression levels 0, 1 and 2, SH degree 0 to 2. Read only.

A header of 4096 bytes, one of 1024 bytes for each section, then the sections; all is little-endian. A section
has the lengths of its partly filled buckets (u32), the middles of all buckets (3 float32),
and its splats: position, scales (linear), quaternion wxyz, rgba as bytes, SH above degree 0, degree by degree and in
a degree all red, all green, all blue.

=====  =============================  ==================  =====================================
level  position                       scale, quaternion   SH
=====  =============================  ==================  =====================================
0      float32                        float32             float32
1      16 bits about its bucket's     float16             float16
       middle: steps of block / 65534
2      the same                       float16             8 bits between the header's bounds
=====  =============================  ==================  =====================================

Full buckets come first, in order; the splats of the others follow. The files have neither antialiasing nor an up axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, TypeVar

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.errors import FormatError
from glsplat.extras.formats.packed import read_rows
from glsplat.formats.format import Format, Opened
from glsplat.splats import SH_C0, Splats, normalised

_Row = TypeVar("_Row", bound=np.generic)

_BLOCK = 1 << 15  # splats converted at a time
_MOST_SECTIONS = 1 << 14  # writers make some hundreds at most
_MIDDLE = 12  # bytes of the middle of a bucket
_RANGES = (1, 32767, 32767)  # default range of 16-bit positions, by level
_COEFFICIENTS = (0, 3, 8)  # above degree 0, of a channel, by degree
_SH_BOUNDS = (-1.5, 1.5)  # default
_HEADER = np.dtype(
    {
        "names": ["major", "minor", "sections", "count", "level", "sh_bounds"],
        "formats": ["u1", "u1", "<u4", "<u4", "<u2", ("<f4", 2)],
        "offsets": [0, 1, 4, 16, 20, 36],
        "itemsize": 4096,
    }
)
_SECTION = np.dtype(
    {
        "names": ["count", "most", "bucket", "buckets", "block", "stored", "range", "full", "partial", "degree"],
        "formats": ["<u4", "<u4", "<u4", "<u4", "<f4", "<u2", "<u4", "<u4", "<u4", "<u2"],
        "offsets": [0, 4, 8, 12, 16, 20, 24, 32, 36, 40],
        "itemsize": 1024,
    }
)


@dataclass(frozen=True)
class _Section:
    """Offsets of a section's parts, checked against the file, and the units of its numbers."""

    count: int
    degree: int
    lengths: int  # byte offset of the lengths of the partly filled buckets
    middles: int
    splats: int
    bucket: int  # splats in a full bucket
    full: int
    partial: int
    range: int  # value of a 16-bit position in its bucket's middle
    step: float  # metres
    record: np.dtype[np.void]


def read_ksplat(file: BinaryIO, size: int) -> Splats:
    """Read the splats of an open file of ``size`` bytes, in its order; SH of the highest degree of its sections.

    Raises FormatError for another version, or a header that does not match the file.
    """
    header = _rows(file, 0, 1, _HEADER, size)[0]
    level, expected = int(header["level"]), int(header["count"])
    if (header["major"], header["minor"]) != (0, 1):
        raise FormatError(f"KSPLAT is read in version 0.1, but this is {header['major']}.{header['minor']}")
    if level > 2:
        raise FormatError(f"KSPLAT has the compression levels 0, 1 and 2, but this says {level}")
    sections = list(_sections(file, size, int(header["sections"]), level))
    count = sum(section.count for section in sections)
    if count != expected:
        raise FormatError(f"the header says {expected} splats, its sections hold {count}")
    coefficients = 1 + _COEFFICIENTS[max((section.degree for section in sections), default=0)]
    bounds = [float(found) or usual for found, usual in zip(header["sh_bounds"], _SH_BOUNDS, strict=True)]
    means, scales = np.empty((2, count, 3), np.float32)
    quats, opacities = np.empty((count, 4), np.float32), np.empty(count, np.float32)
    colours = np.zeros((count, coefficients, 3), np.float32)
    at = 0
    for section in sections:
        for rows, middles in _blocks(file, size, section, level):
            part = slice(at, at := at + len(rows))
            with np.errstate(over="ignore", invalid="ignore"):
                centre = rows["mean"].astype(np.float64)
                means[part] = (centre - section.range) * section.step + middles if level else centre
                scales[part] = rows["scale"]
                quats[part] = normalised(rows["rot"].astype(np.float32))
                rgba = rows["rgba"].astype(np.float32) / 255
                opacities[part] = rgba[:, 3]
                colours[part, 0] = (rgba[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
                rest = rows["sh"].astype(np.float32)
                if level == 2:
                    rest = rest / np.float32(255) * np.float32(bounds[1] - bounds[0]) + np.float32(bounds[0])
            for degree in range(1, section.degree + 1):
                first, stop = degree**2, (degree + 1) ** 2
                own = rest[:, 3 * (first - 1) : 3 * (stop - 1)].reshape(-1, 3, stop - first)
                colours[part, first:stop] = own.transpose(0, 2, 1)
    return Splats(frozen(means), frozen(quats), frozen(scales), frozen(opacities), frozen(colours))


def _sections(file: BinaryIO, size: int, count: int, level: int) -> Iterator[_Section]:
    if count > _MOST_SECTIONS:
        raise FormatError(f"a KSPLAT of {count} sections is not supported; {_MOST_SECTIONS} is the most")
    at = _HEADER.itemsize + count * _SECTION.itemsize
    for index, row in enumerate(_rows(file, _HEADER.itemsize, count, _SECTION, size)):
        found = {name: row[name].item() for name in _SECTION.names or ()}
        if found["degree"] >= len(_COEFFICIENTS):
            raise FormatError(f"section {index} has SH degree {found['degree']}; KSPLAT has 0 to 2")
        if found["count"] > found["most"]:
            raise FormatError(f"section {index} says {found['count']} splats of {found['most']} at most")
        if level and found["buckets"] and found["stored"] != _MIDDLE:
            raise FormatError(f"section {index} has {found['stored']} bytes a bucket; KSPLAT has {_MIDDLE}")
        used = found["full"] + found["partial"]
        if level and used > min(found["buckets"], found["most"]):
            raise FormatError(f"section {index} uses {used} buckets of {found['buckets']} for {found['most']} splats")
        record = _record(level, found["degree"])
        middles = at + 4 * found["partial"]
        splats = middles + found["stored"] * found["buckets"]
        end = splats + record.itemsize * found["most"]
        if end > size:
            raise FormatError(f"truncated: section {index} ends at {end} bytes, the file has {size}")
        scale = found["range"] or _RANGES[level]
        yield _Section(
            found["count"], found["degree"], at, middles, splats, found["bucket"], found["full"], found["partial"],
            scale, found["block"] / 2 / scale, record,
        )  # fmt: skip
        at = end


def _record(level: int, degree: int) -> np.dtype[np.void]:
    """Return the type of a splat's record."""
    position, others, harmonics = (("<f4",) * 3, ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1"))[level]
    fields = [("mean", position, 3), ("scale", others, 3), ("rot", others, 4), ("rgba", "u1", 4)]
    return np.dtype([*fields, ("sh", harmonics, 3 * _COEFFICIENTS[degree])])


def _blocks(
    file: BinaryIO, size: int, section: _Section, level: int
) -> Iterator[tuple[NDArray[np.void], NDArray[np.float64]]]:
    """Yield splats in blocks, with the centres [N, 3] of their buckets (level 0 has none)."""
    ends, middles = _buckets(file, size, section) if level else (np.empty(0, np.int64), np.empty((0, 3)))
    for at in range(0, section.count, _BLOCK):
        count = min(_BLOCK, section.count - at)
        rows = _rows(file, section.splats + at * section.record.itemsize, count, section.record, size)
        yield rows, middles[np.searchsorted(ends, np.arange(at, at + count), "right")] if level else middles


def _buckets(file: BinaryIO, size: int, section: _Section) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the ends of the buckets and their centres. Raises FormatError if they hold too few splats."""
    lengths = _rows(file, section.lengths, section.partial, np.dtype("<u4"), size).astype(np.int64)
    ends = np.append(np.full(section.full, section.bucket, np.int64), lengths).cumsum()
    held = int(ends[-1]) if len(ends) else 0
    if held < section.count:
        raise FormatError(f"the buckets of a section of {section.count} splats hold {held}")
    return ends, _rows(file, section.middles, 3 * len(ends), np.dtype("<f4"), size).astype(np.float64).reshape(-1, 3)


def _rows(file: BinaryIO, at: int, count: int, dtype: np.dtype[_Row], size: int) -> NDArray[_Row]:
    """Read ``count`` rows from the byte ``at``. Raises FormatError if the file is shorter."""
    if at + count * dtype.itemsize > size:
        raise FormatError(f"truncated: the headers declare {at + count * dtype.itemsize} bytes, the file has {size}")
    return read_rows(file, at, count, dtype)


def _sniff(start: Opened) -> bool:
    """Return whether the header is a KSPLAT's: a font with the same first four bytes has huge numbers after them."""
    if start.named(*KSPLAT.suffixes):  # other versions too, for a clear error
        return start.head.startswith(b"\0") and start.head[2:4] == b"\0\0"
    sections, level = (int.from_bytes(start.head[at:to], "little") for at, to in ((4, 8), (20, 22)))
    return start.head.startswith(b"\0\1\0\0") and sections <= _MOST_SECTIONS and level <= 2


KSPLAT = Format(
    name="ksplat",
    title="KSPLAT",
    suffixes=(".ksplat",),
    sniff=_sniff,
    load=lambda start: read_ksplat(start.file, start.size),
    save=None,
)
