"""Read photographs as phones write them: upright RGB pixels, and the focal length if the file has it.

Pillow reads the header, the colour profile and EXIF data before any pixels are decoded.
"""

from __future__ import annotations

import io
import math
import os
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image
from PIL.ExifTags import IFD, Base
from PIL.Image import DecompressionBombError
from PIL.ImageFile import ImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.WebPImagePlugin import WebPImageFile

from glsplat.errors import FormatError
from glsplat.extras.formats.texture import clean_png
from glsplat.io.files import open_regular

# the readers themselves, not Image.open(), which warns about large pictures: the caller checks the size
_READERS: dict[str, type[ImageFile]] = {"JPEG": JpegImageFile, "PNG": PngImageFile, "WebP": WebPImageFile}
_SIGNATURES = ((b"\xff\xd8\xff", "JPEG"), (b"\x89PNG\r\n\x1a\n", "PNG"))
_END_MARKERS = {"JPEG": b"\xff\xd9", "PNG": b"IEND\xaeB`\x82", "WebP": b""}  # libwebp checks a WebP's length
_ISO_BRANDS = {  # of ISO media files
    b"heic": "HEIC", b"heix": "HEIC", b"hevc": "HEIC", b"mif1": "HEIC", b"msf1": "HEIC", b"heim": "HEIC",
    b"avif": "AVIF", b"avis": "AVIF", b"crx ": "RAW",
}  # fmt: skip
_OTHER_SIGNATURES = (
    (b"FUJIFILMCCD-RAW", "RAW"), (b"IIRO", "RAW"), (b"IIU\0", "RAW"), (b"FOVb", "RAW"),
    (b"II*\0", "RAW or TIFF"), (b"MM\0*", "RAW or TIFF"), (b"GIF8", "GIF"), (b"BM", "BMP"),
    (b"\0\0\0\x0cJXL ", "JPEG XL"), (b"\xff\x0a", "JPEG XL"), (b"\0\0\0\x0cjP  ", "JPEG 2000"), (b"%PDF", "PDF"),
)  # fmt: skip
_ADVICE = {
    "HEIC": "on an iPhone choose Settings, Camera, Formats, Most Compatible, or share it as JPEG",
    "RAW": "develop it and save it as JPEG",
    "RAW or TIFF": "develop it and save it as JPEG or PNG",
    "video": "glsplat avatar video makes an avatar of one, or save one picture of it as JPEG or PNG",
}
_FILM_DIAGONAL_MM = math.hypot(36, 24)
_MIN_FOCAL_MM, _MAX_FOCAL_MM = 10, 200  # on 35 mm film: lenses that photograph a whole person
MAX_PIXELS = 64_000_000
"""Larger pictures are refused before they are decoded."""
MAX_BYTES = 100_000_000
"""Size of the largest file that is read."""
_MAX_FILE_SIDE_PX = 30_000  # OpenCV's warps stop at 32767
MAX_SIDE_PX = 2048
"""Larger pictures are reduced to this side; an avatar shows no more detail."""
_HARMLESS_WARNING = "extraneous bytes"  # libjpeg's, about files that some phones write


@dataclass(frozen=True)
class _ImageHeader:
    """The header of a file of a supported kind."""

    kind: str
    """JPEG, PNG or WebP."""
    width: int
    height: int
    channels: int
    """1 for grey, 3 for colour, 4 for ink (CMYK) or transparency."""
    exif: bytes
    """Empty if the file has none."""
    profile: bool
    """A colour profile is embedded."""


def _read_header(data: bytes) -> _ImageHeader:
    """Parse the header and check that the file is whole. Raises FormatError for other kinds and damaged files."""
    kind = next((name for start, name in _SIGNATURES if data.startswith(start)), "")
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        kind = "WebP"
    if not kind:
        raise FormatError(_refusal(data))
    file = io.BytesIO(data)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about damaged metadata
            image = _READERS[kind](file)
            parsed = file.tell()  # bytes
            if kind == "PNG":
                image.verify()  # the check sums
    except DecompressionBombError:
        raise FormatError(f"the {kind} file claims too many pixels; save it smaller") from None
    except Exception as error:  # Pillow raises many types for damaged files
        text = " ".join(str(error).split())[:120]
        raise FormatError(f"the {kind} file cannot be read ({text}); copy it again or save it again") from None
    if data.find(_END_MARKERS[kind], parsed) < 0:
        raise FormatError(f"the {kind} file ends in the middle of the picture; copy it again")
    if isinstance(image, WebPImageFile) and image.is_animated:
        raise FormatError("an animated WebP is not a photograph; save one picture of it as JPEG or PNG")
    profile = image.info.get("icc_profile") is not None
    return _ImageHeader(kind, *image.size, len(image.getbands()), image.info.get("exif", b""), profile)


def _refusal(data: bytes) -> str:
    if not data:
        return "the file is empty"
    found = next((name for start, name in _OTHER_SIGNATURES if data.startswith(start)), "")
    if data[4:8] == b"ftyp":
        found = _ISO_BRANDS.get(data[8:12], "video")
    if not found:
        return f"expected a photograph (JPEG, PNG or WebP), found bytes that begin with {data[:4]!r}"
    return f"{found} is not read; {_ADVICE.get(found, 'save the picture as JPEG or PNG')}"


def _read_exif(data: bytes, size: tuple[int, int]) -> tuple[int, float | None]:
    """Return orientation (1 to 8, 1: as stored) and focal length in diagonals of a picture. Never raises.

    ``size`` is the stored (width, height). The focal length is None if it is missing or implausible, or
    if the EXIF data name a picture of other proportions, because it was cropped.
    """
    exif, orientation, camera = Image.Exif(), 1, dict[int, object]()
    with warnings.catch_warnings(), suppress(Exception):  # Pillow raises many types for damaged data
        warnings.simplefilter("ignore")
        exif.load(data)
        orientation = exif.get(Base.Orientation, 1)
        camera = exif.get_ifd(IFD.Exif)
    known = isinstance(orientation, int) and 1 <= orientation <= 8
    return orientation if known else 1, _focal(camera, size)


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
    header = _read_header(data)
    width, height = header.width, header.height
    if width * height > MAX_PIXELS or max(width, height) > _MAX_FILE_SIDE_PX:
        raise FormatError(
            f"{width} x {height} pixels are too many (at most {MAX_PIXELS // 10**6} megapixels and "
            f"{_MAX_FILE_SIDE_PX} a side); save it smaller"
        )
    orientation, focal = _read_exif(header.exif, (width, height)) if header.exif else (1, None)
    notes: list[str] = []
    picture, alpha = (_decode_jpeg(data, header), None) if header.kind == "JPEG" else _decode_other(data, header, notes)
    if picture.shape[:2] != (height, width):
        raise FormatError(f"the {header.kind} file says {width} x {height} pixels and holds others; save it again")
    if header.profile:
        notes.append("the embedded colour profile is not applied: colours may look a little paler")
    picture = _upright(picture, orientation)
    alpha = None if alpha is None else np.ascontiguousarray(_upright(alpha, orientation))
    size = picture.shape[1], picture.shape[0]
    if max(size) > side:
        picture, alpha = reduced(picture, side), None if alpha is None else reduced(alpha, side)
        notes.append(f"{size[0]} x {size[1]} pixels were reduced to {picture.shape[1]} x {picture.shape[0]}")
    focal = None if focal is None else focal * math.hypot(*picture.shape[:2])
    return Photo(np.ascontiguousarray(picture), focal, size, tuple(notes), alpha)


def reduced(picture: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    """Return the picture [H, W] or [H, W, 3] with at most ``side`` pixels a side."""
    scale = side / max(picture.shape[:2])
    if scale >= 1:
        return picture
    height, width = (max(round(extent * scale), 1) for extent in picture.shape[:2])
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _decode_jpeg(data: bytes, header: _ImageHeader) -> NDArray[np.uint8]:
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
    data: bytes, header: _ImageHeader, notes: list[str]
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
