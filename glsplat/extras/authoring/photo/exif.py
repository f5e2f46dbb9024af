"""Read a photograph's orientation and focal length from its EXIF data with Pillow; implausible values are ignored."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

from PIL import Image
from PIL.ExifTags import IFD, Base

_FILM_DIAGONAL_MM = math.hypot(36, 24)
_MIN_FOCAL_MM, _MAX_FOCAL_MM = 10, 200  # on 35 mm film: lenses that photograph a whole person


@dataclass(frozen=True)
class Exif:
    """The EXIF values of a photograph that are used."""

    orientation: int = 1
    """1 to 8 as EXIF counts; 1: as stored."""
    focal: float | None = None
    """Focal length in diagonals of the picture; None if it is missing or implausible."""


def read_exif(data: bytes, size: tuple[int, int]) -> Exif:
    """Parse EXIF data of a picture whose stored ``size`` is (width, height). Never raises.

    The focal length is ignored if the EXIF data name a picture of other proportions, because it was cropped.
    """
    exif, orientation, camera = Image.Exif(), 1, dict[int, object]()
    with warnings.catch_warnings(), suppress(Exception):  # Pillow raises many types for damaged data
        warnings.simplefilter("ignore")
        exif.load(data)
        orientation = exif.get(Base.Orientation, 1)
        camera = exif.get_ifd(IFD.Exif)
    known = isinstance(orientation, int) and 1 <= orientation <= 8
    return Exif(orientation if known else 1, _focal(camera, size))


def _focal(camera: Mapping[int, object], size: tuple[int, int]) -> float | None:
    tags = Base.FocalLengthIn35mmFilm, Base.ExifImageWidth, Base.ExifImageHeight
    millimetres, *stored = (value if isinstance(value := camera.get(tag), int) else 0 for tag in tags)
    if not _MIN_FOCAL_MM <= millimetres <= _MAX_FOCAL_MM:
        return None
    if min(stored) > 0:
        before, now = max(stored) / min(stored), max(size) / min(size)
        if abs(before - now) > 0.02 * now:
            return None
    return millimetres / _FILM_DIAGONAL_MM
