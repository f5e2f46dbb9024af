"""Photographs as phones write them: upright RGB pixels, and the focal length where the file tells it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.png import clean_png
from glsplat.io.files import open_regular

from .exif import Exif, read_exif
from .headers import ImageHeader, read_header

__all__ = ["MOST_BYTES", "MOST_PIXELS", "SIDE", "Photo", "photo_of", "read_photo"]

MOST_PIXELS = 64_000_000
"""More is refused before a pixel is decoded."""
MOST_BYTES = 100_000_000
_LONGEST = 30_000  # pixels; OpenCV's warps stop at 32767
SIDE = 2048
"""Pixels of the longer side that are kept; an avatar shows no more."""
_HARMLESS = "extraneous bytes"  # what libjpeg says of files that some phones write


@dataclass(frozen=True, eq=False)
class Photo:
    """A photograph, turned as it was seen."""

    picture: NDArray[np.uint8]
    """RGB uint8 [H, W, 3], sRGB as the file has it; embedded colour profiles are not applied."""
    focal: float | None
    """Focal length in pixels of ``picture``; None where the file tells none that can be true."""
    size: tuple[int, int]
    """Width and height of the file's picture, upright, before it was made smaller."""
    notes: tuple[str, ...] = ()
    """What a user may want to know, in words."""
    alpha: NDArray[np.uint8] | None = None
    """[H, W] of a picture that is transparent somewhere: 0 where it is, 255 where it is not."""


def read_photo(path: str | os.PathLike[str], side: int = SIDE) -> Photo:
    """Read a JPEG, PNG or WebP file; the longer side becomes at most ``side`` pixels.

    All eight EXIF orientations, grey, ink colours, transparency (laid over white) and 16 bits are understood. Raises
    FormatError, one line that names the file, for everything else: other kinds, damage, more than MOST_PIXELS.
    """
    try:
        with open_regular(Path(path)) as (file, _):
            data = file.read(MOST_BYTES + 1)
        return photo_of(data, side)
    except FormatError as error:
        text = str(error)
        raise FormatError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def photo_of(data: bytes, side: int = SIDE) -> Photo:
    """``read_photo`` of a file's bytes."""
    if len(data) > MOST_BYTES:
        raise FormatError(f"a photograph has at most {MOST_BYTES // 10**6} MB; save it smaller")
    header = read_header(data)
    width, height = header.width, header.height
    if width * height > MOST_PIXELS or max(width, height) > _LONGEST:
        raise FormatError(
            f"{width} x {height} pixels are too many (at most {MOST_PIXELS // 10**6} megapixels and "
            f"{_LONGEST} a side); save it smaller"
        )
    exif = read_exif(header.exif, (width, height)) if header.exif else Exif()
    notes: list[str] = []
    picture, alpha = (_jpeg(data, header), None) if header.kind == "JPEG" else _other(data, header, notes)
    if picture.shape[:2] != (height, width):
        raise FormatError(f"the {header.kind} file says {width} x {height} pixels and holds others; save it again")
    if header.profile:
        notes.append("the embedded colour profile is not applied: colours may look a little paler")
    picture = _upright(picture, exif.orientation)
    alpha = None if alpha is None else np.ascontiguousarray(_upright(alpha, exif.orientation))
    size = picture.shape[1], picture.shape[0]
    if max(size) > side:
        scale = side / max(size)
        target = max(round(size[0] * scale), 1), max(round(size[1] * scale), 1)
        picture = np.asarray(cv2.resize(picture, target, interpolation=cv2.INTER_AREA), np.uint8)
        if alpha is not None:
            alpha = np.asarray(cv2.resize(alpha, target, interpolation=cv2.INTER_AREA), np.uint8)
        notes.append(f"{size[0]} x {size[1]} pixels were reduced to {target[0]} x {target[1]}")
    focal = None if exif.focal is None else exif.focal * math.hypot(*picture.shape[:2])
    return Photo(np.ascontiguousarray(picture), focal, size, tuple(notes), alpha)


def _jpeg(data: bytes, header: ImageHeader) -> NDArray[np.uint8]:
    space = "CMYK" if header.channels == 4 else "RGB"
    try:
        try:
            pixels = simplejpeg.decode_jpeg(data, space, strict=True)
        except ValueError as error:
            if _HARMLESS not in str(error):
                raise
            pixels = simplejpeg.decode_jpeg(data, space, strict=False)
    except (ValueError, RuntimeError, MemoryError) as error:
        raise FormatError(f"the JPEG file is damaged ({' '.join(str(error).split())[:120]}); copy it again") from None
    if space == "RGB":
        return np.asarray(pixels, np.uint8)
    ink = pixels.astype(np.uint16)  # Adobe's way, the only one in use: 255 is no ink
    return ((ink[..., :3] * ink[..., 3:] + 127) // 255).astype(np.uint8)


def _other(data: bytes, header: ImageHeader, notes: list[str]) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """The colours, and the transparency where there is some."""
    if header.kind == "PNG":
        data = clean_png(data)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise FormatError(f"the {header.kind} file is damaged and cannot be decoded; copy it again")
    if pixels.dtype == np.uint16:
        pixels = np.asarray(cv2.convertScaleAbs(pixels, alpha=1 / 257), np.uint8)
    if pixels.dtype != np.uint8:
        raise FormatError(f"the {header.kind} file holds {pixels.dtype} values; save it with 8 bits a channel")
    if pixels.ndim == 2 or pixels.shape[2] == 1:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB), np.uint8), None
    if pixels.shape[2] == 2:  # grey with transparency
        pixels = pixels[..., [0, 0, 0, 1]]
    colour = pixels[..., 2::-1]
    if pixels.shape[2] == 3 or (pixels[..., 3] == 255).all():
        return np.ascontiguousarray(colour), None
    alpha = pixels[..., 3:].astype(np.uint16)
    notes.append("transparent parts were laid over white")
    return ((colour * alpha + 255 * (255 - alpha) + 127) // 255).astype(np.uint8), pixels[..., 3]


def _upright(picture: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Undo what EXIF says that the camera did (1: nothing; 2 to 8)."""
    if orientation >= 5:
        picture = picture.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    return picture
