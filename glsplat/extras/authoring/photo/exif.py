"""The few EXIF entries that a photograph needs: which way is up, and the focal length. Lying entries are left out."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

__all__ = ["Exif", "read_exif"]

_ORIENTATION, _EXIF_FOLDER = 0x0112, 0x8769
_WIDTH, _HEIGHT, _FOCAL_35MM = 0xA002, 0xA003, 0xA405
_SIZES = {3: ("H", 2), 4: ("I", 4)}  # SHORT and LONG
_DIAGONAL_35MM = math.hypot(36, 24)  # millimetres
_PLAUSIBLE = (10.0, 200.0)  # millimetres at 35 mm film: nobody takes a whole body with anything else
_ENTRIES = 512  # more than any camera writes


@dataclass(frozen=True)
class Exif:
    """What is believed of a picture's EXIF data."""

    orientation: int = 1
    """1 to 8 as EXIF counts; 1: as stored."""
    focal: float | None = None
    """Focal length in diagonals of the picture; None where there is none that can be true."""


def read_exif(data: bytes, size: tuple[int, int]) -> Exif:
    """Read a TIFF structure as EXIF has it, of a picture of ``size`` (width, height) as stored. Never raises.

    The focal length is left out when the EXIF data tell of a picture of other proportions: it was cropped since.
    """
    data = data.removeprefix(b"Exif\0\0")
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(data[:4])
    if order is None or len(data) < 8:
        return Exif()
    first = _folder(data, struct.unpack_from(order + "I", data, 4)[0], order)
    orientation = first.get(_ORIENTATION, 1)
    inner = _folder(data, first[_EXIF_FOLDER], order) if _EXIF_FOLDER in first else {}
    return Exif(orientation if 1 <= orientation <= 8 else 1, _focal(inner, size))


def _focal(entries: dict[int, int], size: tuple[int, int]) -> float | None:
    millimetres = entries.get(_FOCAL_35MM, 0)
    if not _PLAUSIBLE[0] <= millimetres <= _PLAUSIBLE[1]:
        return None
    told = entries.get(_WIDTH, 0), entries.get(_HEIGHT, 0)
    if min(told) > 0:
        then, now = max(told) / min(told), max(size) / min(size)
        if abs(then - now) > 0.02 * now:
            return None
    return millimetres / _DIAGONAL_35MM


def _folder(data: bytes, start: int, order: str) -> dict[int, int]:
    """The whole numbers of one IFD, by tag; what points nowhere is left out."""
    found: dict[int, int] = {}
    if not 8 <= start <= len(data) - 2:
        return found
    count = min(struct.unpack_from(order + "H", data, start)[0], _ENTRIES, (len(data) - start - 2) // 12)
    for index in range(count):
        place = start + 2 + 12 * index
        tag, kind, number = struct.unpack_from(order + "HHI", data, place)
        if number == 1 and kind in _SIZES:
            found.setdefault(tag, struct.unpack_from(order + _SIZES[kind][0], data, place + 8)[0])
    return found
