"""Read photographs as phones write them: upright RGB pixels, and the focal length if the file has it."""

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
from glsplat.extras.formats.texture import clean_png
from glsplat.io.files import open_regular

from .exif import Exif, read_exif
from .headers import ImageHeader, read_header

MAX_PIXELS = 64_000_000
"""Larger pictures are refused before they are decoded."""
MAX_BYTES = 100_000_000
"""Size of the largest file that is read."""
_MAX_FILE_SIDE_PX = 30_000  # OpenCV's warps stop at 32767
MAX_SIDE_PX = 2048
"""Larger pictures are reduced to this side; an avatar shows no more detail."""
_HARMLESS_WARNING = "extraneous bytes"  # libjpeg's, about files that some phones write


@dataclass(frozen=True, eq=False)
class Photo:
    """A photograph, turned upright."""

    picture: NDArray[np.uint8]
    """RGB uint8 [H, W, 3], sRGB; embedded colour profiles are not applied."""
    focal: float | None
    """Focal length in pixels of ``picture``; None if the file has no plausible one."""
    size: tuple[int, int]
    """Width and height of the file's picture, upright, before it was reduced."""
    notes: tuple[str, ...] = ()
    """Remarks for the user, one sentence each."""
    alpha: NDArray[np.uint8] | None = None
    """[H, W] opacity of a partly transparent picture, 0 to 255."""


def read_photo(path: str | os.PathLike[str], side: int = MAX_SIDE_PX) -> Photo:
    """Read a JPEG, PNG or WebP file; the longer side becomes at most ``side`` pixels.

    Supports all eight EXIF orientations, grey, CMYK, transparency (composited over white) and 16 bits. Raises
    FormatError, one line that names the file, for other kinds, damaged files and more than MAX_PIXELS.
    """
    try:
        with open_regular(Path(path)) as (file, _):
            data = file.read(MAX_BYTES + 1)
        return decode_photo(data, side)
    except FormatError as error:
        text = str(error)
        raise FormatError(text if text.startswith(str(path)) else f"{path}: {text}") from None


def decode_photo(data: bytes, side: int = MAX_SIDE_PX) -> Photo:
    """Decode the bytes of a file; see ``read_photo``."""
    if len(data) > MAX_BYTES:
        raise FormatError(f"a photograph has at most {MAX_BYTES // 10**6} MB; save it smaller")
    header = read_header(data)
    width, height = header.width, header.height
    if width * height > MAX_PIXELS or max(width, height) > _MAX_FILE_SIDE_PX:
        raise FormatError(
            f"{width} x {height} pixels are too many (at most {MAX_PIXELS // 10**6} megapixels and "
            f"{_MAX_FILE_SIDE_PX} a side); save it smaller"
        )
    exif = read_exif(header.exif, (width, height)) if header.exif else Exif()
    notes: list[str] = []
    picture, alpha = (_decode_jpeg(data, header), None) if header.kind == "JPEG" else _decode_other(data, header, notes)
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


def _decode_jpeg(data: bytes, header: ImageHeader) -> NDArray[np.uint8]:
    space = "CMYK" if header.channels == 4 else "RGB"
    try:
        try:
            pixels = simplejpeg.decode_jpeg(data, space, strict=True)
        except ValueError as error:
            if _HARMLESS_WARNING not in str(error):
                raise
            pixels = simplejpeg.decode_jpeg(data, space, strict=False)
    except (ValueError, RuntimeError, MemoryError) as error:
        raise FormatError(f"the JPEG file is damaged ({' '.join(str(error).split())[:120]}); copy it again") from None
    if space == "RGB":
        return np.asarray(pixels, np.uint8)
    ink = pixels.astype(np.uint16)  # Adobe's convention, the only one in use: 255 is no ink
    return ((ink[..., :3] * ink[..., 3:] + 127) // 255).astype(np.uint8)


def _decode_other(
    data: bytes, header: ImageHeader, notes: list[str]
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Return the RGB colours of a PNG or WebP file, over white, and its opacity if it is partly transparent."""
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
    """Return the picture turned upright from the EXIF ``orientation`` (1 to 8; 1: upright)."""
    if orientation >= 5:
        picture = picture.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        picture = picture[::-1]
    if orientation in (2, 3, 6, 7):
        picture = picture[:, ::-1]
    return picture
