"""A JPEG of a whole picture of which only the covered part goes through the codec; the black around it is ready-made.

Restart intervals (ITU-T T.81, B.2.4.4, E.1.4) make it possible: each one starts anew and ends on a whole byte, so the
intervals of the covered part and copies of one black interval can be put into any order. Any decoder reads them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import cycle

import cv2  # not when first needed: its import changes sys.path for a moment, and a process spawned then inherits that
import numpy as np
from numpy.typing import NDArray

__all__ = ["encode_covered"]

_BLOCK = 16  # pixels of a 4:2:0 block (minimum coded unit)
_LENGTHS = (8, 7, 9, 6, 10, 5, 11, 4, 12)  # blocks an interval may have: short ones fit the box, long ones are fewer
_WORTH = 0.7  # of the picture's intervals: above that the whole picture is encoded faster at once
_SOF0, _SOS = 0xC0, 0xDA
_RESTART = [bytes((0xFF, 0xD0 + i)) for i in range(8)]
_BETWEEN = re.compile(rb"\xff[\xd0-\xd7]")
_END = b"\xff\xd9"


def encode_covered(image: NDArray[np.uint8], box: tuple[int, int, int, int], quality: int) -> bytes | None:
    """Baseline JPEG, 4:2:0, of an RGBX picture [H, W, 4] that is zero outside ``box`` (x, y, width, height).

    The same bytes as encoding all of it with restart intervals. None where that would be no gain, or the width has no
    fitting intervals.
    """
    height, width = image.shape[:2]
    columns, lines = -(-width // _BLOCK), -(-height // _BLOCK)
    length = next((n for n in _LENGTHS if columns % n == 0), 0)
    if not length:
        return None
    per_line, step = columns // length, length * _BLOCK
    x, y, w, h = box
    left, right, top, bottom = x // step, -(-(x + w) // step), y // _BLOCK, -(-(y + h) // _BLOCK)
    if w < 1 or h < 1:
        right, bottom = left, top
    if (right - left) * (bottom - top) > _WORTH * per_line * lines:
        return None
    header, black = _black(length, quality)
    if right > left and bottom > top:
        part = image[top * _BLOCK : bottom * _BLOCK, left * step : right * step]
        _, scan = _encode(part, length, quality)
        inside = iter(_BETWEEN.split(scan))
    else:
        inside = iter(())

    def intervals() -> Iterator[bytes]:
        for line in range(lines):
            covered = range(left, right) if top <= line < bottom else range(0)
            for column in range(per_line):
                yield next(inside) if column in covered else black

    parts = [piece for pair in zip(intervals(), cycle(_RESTART), strict=False) for piece in pair]
    parts[-1] = _END
    sized = bytearray(header)
    at = _marker(header, _SOF0) + 5  # behind marker, length and precision: height, width
    sized[at : at + 4] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    return b"".join([sized, *parts])


@lru_cache(maxsize=128)
def _black(length: int, quality: int) -> tuple[bytes, bytes]:
    """Header of any picture with such intervals, and a black interval."""
    return _encode(np.zeros((_BLOCK, length * _BLOCK, 4), np.uint8), length, quality)


def _encode(image: NDArray[np.uint8], length: int, quality: int) -> tuple[bytes, bytes]:
    """Header up to the entropy-coded data, and these data."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, length]
    options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGBA2BGR), options)
    data = encoded.tobytes()
    start = _marker(data, _SOS)
    start += 2 + int.from_bytes(data[start + 2 : start + 4], "big")
    return data[:start], data[start : -len(_END)]


def _marker(data: bytes, wanted: int) -> int:
    """Where a header segment begins."""
    at = 2
    while data[at + 1] != wanted:
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return at
