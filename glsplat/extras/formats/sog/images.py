"""Images of a SOG: eight bits a channel, lossless; their size is checked before they are decoded."""

from __future__ import annotations

import struct
from typing import cast

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.formats.sog.package import Package

_HEAD = 1 << 12  # bytes in which the size must be
_CHUNKS = 16  # of a WebP, before its image


def decoded(package: Package, name: str, least: int, most: int) -> NDArray[np.uint8]:
    """Decode RGBA [H, W, 4] of the image ``name``: lossless WebP, or PNG; without alpha it is 255.

    Raises FormatError before decoding if it has fewer than ``least`` or more than ``most`` pixels, or more bytes than
    its pixels can need.
    """
    import cv2  # not at the top, as it takes 0.1 s

    with package.open(name) as (file, size):
        head = file.read(_HEAD)
        width, height = _size(head, name)
        if not least <= width * height <= most:
            raise FormatError(
                f"{name:.60} has {width} x {height} pixels, but needs {least} or somewhat more"
                if least < most
                else f"{name:.60} needs {least} pixels, not {width} x {height}"
            )
        if size > 5 * width * height + (1 << 16):
            raise FormatError(f"{name:.60} has {size} bytes, more than an image of {width} x {height} pixels can need")
        data = head + file.read(max(size - len(head), 0))
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the caller's error is the only line
    try:
        # IMREAD_UNCHANGED: alpha is kept, colours are not touched where it is 0
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None or image.dtype != np.uint8 or image.shape not in ((height, width, 3), (height, width, 4)):
        raise FormatError(f"{name:.60} cannot be decoded (damaged?)")
    turned = cv2.cvtColor(image, cv2.COLOR_BGRA2RGBA if image.shape[2] == 4 else cv2.COLOR_BGR2RGBA)
    return cast("NDArray[np.uint8]", turned)


def encoded(image: NDArray[np.uint8]) -> bytes:
    """Encode RGBA [H, W, 4] as lossless WebP; OpenCV 4.13 and newer keep colours with alpha 0."""
    import cv2

    # older versions have lossless as a quality above 100, and set colours with alpha 0 to black
    mode = getattr(cv2, "IMWRITE_WEBP_LOSSLESS_MODE", None)
    how = [cv2.IMWRITE_WEBP_QUALITY, 101] if mode is None else [mode, cv2.IMWRITE_WEBP_LOSSLESS_PRESERVE_COLOR]
    done, data = cv2.imencode(".webp", cv2.cvtColor(image, cv2.COLOR_RGBA2BGRA), how)
    if not done:
        raise FormatError(f"an image of {image.shape[1]} x {image.shape[0]} pixels cannot be encoded")
    return data.tobytes()


def _size(head: bytes, name: str) -> tuple[int, int]:
    """Return width and height from the header."""
    try:
        if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            return _webp_size(head, name)
        if head.startswith(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"):
            width, height, depth, kind = struct.unpack_from(">IIBB", head, 16)
            if depth != 8 or kind not in (2, 6):
                raise FormatError(f"{name:.60} needs 8 bits of RGB or RGBA, not {depth} bits of PNG type {kind}")
            return width, height
    except struct.error:
        pass
    raise FormatError(f"{name:.60} needs to be a WebP image without loss (or a PNG), but is none")


def _webp_size(head: bytes, name: str) -> tuple[int, int]:
    at = 12
    canvas = None
    for _ in range(_CHUNKS):
        tag, length = struct.unpack_from("<4sI", head, at)
        if tag == b"VP8L":
            mark, bits = struct.unpack_from("<BI", head, at + 8)
            size = 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
            if mark != 0x2F or canvas not in (None, size):
                break
            return size
        if tag == b"VP8X":
            flags, wide, low, high = struct.unpack_from("<I3s2sB", head, at + 8)
            canvas = 1 + int.from_bytes(wide, "little"), 1 + (int.from_bytes(low, "little") | high << 16)
            if flags & 2:
                raise FormatError(f"{name:.60} is an animation")
        if tag in (b"VP8 ", b"ALPH"):
            raise FormatError(f"{name:.60} is WebP with loss, so that its values are wrong; write it without")
        at += 8 + length + length % 2
    raise FormatError(f"{name:.60} needs to be a WebP image without loss, but its header is damaged")
