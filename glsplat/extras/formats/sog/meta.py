"""Parse meta.json of a SOG: version 2 has tables of values, version 1 ranges, which become tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError

BANDS = {1: 3, 2: 8, 3: 15}  # coefficients beyond the first of the spherical harmonics of a degree

MOST_SPLATS = 1 << 25
"""Most splats in a file, above any known one; images of more could decode from a few bytes."""

_BITS16 = np.arange(65536) / 65535
_BITS8 = np.arange(256) / 255

Vec3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Book = Annotated[list[float | None], msgspec.Meta(min_length=1, max_length=256)]
Names = Annotated[list[str], msgspec.Meta(min_length=1, max_length=8)]
Pair = Annotated[list[str], msgspec.Meta(min_length=2, max_length=8)]

_Tables = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float32] | None]
"""``Meta.scales``, ``colours``, ``opacities`` and ``rest``."""


class _Means(msgspec.Struct):
    mins: Vec3
    maxs: Vec3
    files: Pair
    shape: list[int] = []


class _Values(msgspec.Struct):
    files: Names
    codebook: Book | None = None
    mins: list[float] = []
    maxs: list[float] = []


class _Quats(msgspec.Struct):
    files: Names


class _Rest(msgspec.Struct):
    files: Pair
    codebook: Book | None = None
    mins: float | None = None
    maxs: float | None = None
    bands: int | None = None
    count: int | None = None


class _File(msgspec.Struct):
    means: _Means
    scales: _Values
    quats: _Quats
    sh0: _Values
    shN: _Rest | None = None  # noqa: N815
    version: Any = 1
    count: int | None = None
    antialias: Any = False
    model: Any = None


@dataclass(frozen=True, eq=False)
class Meta:
    """Tables that map channel values to attributes, and the names of the images."""

    count: int
    antialias: bool
    means: NDArray[np.float32]  # [3, 65536] metres, by axis and the 16 bits of two images
    scales: NDArray[np.float32]  # [3, 256] standard deviations in metres, by axis
    colours: NDArray[np.float32]  # [3, 256] the first SH coefficient, by channel
    opacities: NDArray[np.float32]  # [256]
    rest: NDArray[np.float32] | None  # [256] the further SH coefficients, of all channels; None without them
    bands: int | None  # degree of those; None: by the width of their image
    palette: int  # number of sets of further coefficients
    files: dict[str, str]  # "means_l", "means_u", "quats", "scales", "sh0", "centroids", "labels"


def parse(text: bytes) -> Meta:
    """Parse the tables of a meta.json. Raises FormatError, one line, for an invalid one."""
    try:
        file = msgspec.json.decode(text.removeprefix(b"\xef\xbb\xbf"), type=_File)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise FormatError(f"meta.json is not that of a SOG: {str(error)[:160]}") from None
    if file.version not in (1, 2) or isinstance(file.version, bool):
        raise FormatError(f"SOG of version 1 and 2 are read, this one is of version {str(file.version)[:16]!r}")
    count = file.count if file.version == 2 else next(iter(file.means.shape), None)
    if count is None:
        raise FormatError("meta.json does not say how many splats there are")
    if not 0 <= count <= MOST_SPLATS:
        raise FormatError(f"meta.json claims {count} splats; a SOG has {MOST_SPLATS} at most")
    with np.errstate(over="ignore", invalid="ignore"):  # infinite values are handled later
        scales, colours, opacities, rest = (_version_2 if file.version == 2 else _version_1)(file)
        pairs = zip(file.means.mins, file.means.maxs, strict=True)
        logs = np.stack([_between(low, high, _BITS16) for low, high in pairs])
        found = (np.sign(logs) * np.expm1(np.abs(logs)), scales, colours, opacities)
        tables = [table.astype(np.float32) for table in found]
    files = {
        "means_l": file.means.files[0],
        "means_u": file.means.files[1],
        "quats": file.quats.files[0],
        "scales": file.scales.files[0],
        "sh0": file.sh0.files[0],
    }
    bands, palette = None, 0
    if file.shN and rest is not None:
        files |= {"centroids": file.shN.files[0], "labels": file.shN.files[1]}
        palette = 65536 if file.shN.count is None else min(max(file.shN.count, 0), 65536)
        bands = file.shN.bands if file.version == 2 else None
    antialias = file.antialias is True or (file.version == 2 and file.model == "antialiased")
    return Meta(count, antialias, tables[0], tables[1], tables[2], tables[3], rest, bands, palette, files)


def _version_2(file: _File) -> _Tables:
    scales = np.exp(_book(file.scales.codebook, "scales"))
    colours = _book(file.sh0.codebook, "sh0")
    rest = None
    if file.shN and file.shN.bands != 0:
        if file.shN.bands not in (None, *BANDS):
            raise FormatError(f"shN.bands of meta.json is 1, 2 or 3, not {file.shN.bands}")
        book = _book(file.shN.codebook, "shN")
        rest = np.where(np.isnan(book), 0, book).astype(np.float32)  # a missing coefficient is 0
    return np.tile(scales, (3, 1)), np.tile(colours, (3, 1)), _BITS8, rest


def _version_1(file: _File) -> _Tables:
    scales = np.exp(_ranges(file.scales, 3, "scales"))
    colours = _ranges(file.sh0, 4, "sh0")
    rest = None
    if file.shN:
        if file.shN.mins is None or file.shN.maxs is None:
            raise FormatError("shN of meta.json needs mins and maxs in version 1")
        rest = _between(file.shN.mins, file.shN.maxs, _BITS8).astype(np.float32)
    return scales, colours[:3], 1 / (1 + np.exp(-colours[3])), rest


def _book(values: list[float | None] | None, what: str) -> NDArray[np.float64]:
    """Return the numbers [256] of a codebook; NaN beyond its end and for null, JSON's NaN and infinity."""
    if values is None:
        raise FormatError(f"{what} of meta.json needs a codebook in version 2")
    book = np.full(256, np.nan)
    book[: len(values)] = [np.nan if value is None else value for value in values]
    if values[0] is None:  # some writers lost an infinity at the low end: as in PlayCanvas's engine
        book[0] = book[1] + (book[1] - book[255]) / 255
    return book


def _ranges(values: _Values, channels: int, what: str) -> NDArray[np.float64]:
    if len(values.mins) != channels or len(values.maxs) != channels:
        raise FormatError(f"{what} of meta.json needs {channels} mins and {channels} maxs in version 1")
    return np.stack([_between(low, high, _BITS8) for low, high in zip(values.mins, values.maxs, strict=True)])


def _between(low: float, high: float, at: NDArray[np.float64]) -> NDArray[np.float64]:
    return low + (high - low) * at
