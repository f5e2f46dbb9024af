"""Decode textures of meshes: JPEG, PNG and WebP to RGBA, checked before any pixel is decoded."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.png import clean_png

_LONGEST = 16_384  # pixels a side; the limit of GL
_MOST = 1 << 26  # pixels: a small file may claim more than memory


def decode_texture(data: bytes | NDArray[np.uint8], where: str) -> NDArray[np.uint8]:
    """Decode a JPEG, PNG or WebP to RGBA uint8 [H, W, 4]. Raises FormatError naming ``where`` for others and damage."""
    buffer = np.frombuffer(data, np.uint8) if isinstance(data, bytes) else data
    if buffer.dtype != np.uint8 or buffer.ndim != 1:
        raise FormatError(f"{where}: a texture is the bytes of a file, not {buffer.dtype} of shape {buffer.shape}")
    said = bytes(buffer[:32])
    width, height = _size(said, buffer)
    if not (width and height):
        raise FormatError(f"{where}: a texture is a JPEG, PNG or WebP, found {said[:4]!r}")
    if width * height > _MOST and max(width, height) <= _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_MOST >> 20} Mi pixels, this one {width} x {height}")
    if max(width, height) > _LONGEST:
        raise FormatError(f"{where}: a texture has at most {_LONGEST} pixels a side, this one {width} x {height}")
    try:
        image = _decoded(said, buffer)
    except (cv2.error, MemoryError, ValueError, RuntimeError, struct.error, IndexError):
        image = None
    except FormatError as error:
        raise FormatError(f"{where}: {error}") from None
    if image is None:
        raise FormatError(f"{where}: the texture, {width} x {height} pixels, cannot be decoded (damaged?)")
    return image


def _decoded(head: bytes, data: NDArray[np.uint8]) -> NDArray[np.uint8] | None:
    """Decode to RGBA; return None or raise the decoder's error for damage. Nothing is printed to stderr."""
    if head.startswith(b"\xff\xd8"):
        space = simplejpeg.decode_jpeg_header(data, strict=False)[2]
        if space != "CMYK":
            return cv2.cvtColor(simplejpeg.decode_jpeg(data, "RGB", strict=False), cv2.COLOR_RGB2RGBA)
    if head.startswith(b"\x89PNG"):
        data = np.frombuffer(clean_png(data.tobytes()), np.uint8)
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the caller's error is the only line
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        return None
    if image.dtype != np.uint8:
        image = (image / 257).astype(np.uint8)
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGBA if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)


def _size(head: bytes, data: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the width and height in a picture's header; 0, 0 for other kinds."""
    if len(head) < 32:
        return 0, 0
    if head.startswith(b"\x89PNG\r\n\x1a\n"):
        width, height = struct.unpack_from(">II", head, 16)
        return width, height
    if head.startswith(b"RIFF") and head[8:15] == b"WEBPVP8":
        lossy, kind = struct.unpack_from("<I", head, 26)[0], head[15:16]
        if kind == b"X":
            wide, high = (int.from_bytes(head[at : at + 3], "little") + 1 for at in (24, 27))
            return wide, high
        bits = struct.unpack_from("<I", head, 21)[0]
        if kind == b"L":
            return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
        return lossy & 0x3FFF, lossy >> 16 & 0x3FFF
    if head.startswith(b"\xff\xd8"):
        try:
            height, width, *_ = simplejpeg.decode_jpeg_header(data, strict=False)
            return width, height
        except (ValueError, RuntimeError, KeyError):
            pass
    return 0, 0
