"""Encodes a whole picture to JPEG although only its covered part goes through the codec; the rest is black.

Each line of blocks is a restart interval (ITU-T T.81, B.2.4.4, E.1.4): it starts anew and ends on a whole byte, so
covered lines and copies of a black one can be joined. Inside a line, a black block after a black one always takes the
same 32 bits (Annex K's tables: no difference, end of block). Such words are inserted left and right of the covered
part, without decoding it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import simplejpeg
from numpy.typing import NDArray

_BLOCK = 16  # pixels of a 4:2:0 block (minimum coded unit)
_MAX_COVERED_SHARE = 0.8  # of the picture's blocks: above it the codec is faster with the whole picture
_CALL_BLOCKS = 15  # blocks that the codec encodes in the time that one more call takes
_SOF0, _SOS = 0xC0, 0xDA
_BLACK = 0x28A28A00  # luminance 00 (no difference) 1010 (end of block), four times; chrominance 00 00, twice
_END = b"\xff\xd9"


def encode_covered(image: NDArray[np.uint8], box: tuple[int, int, int, int], quality: int) -> bytes | None:
    """Return the baseline JPEG, 4:2:0, of an RGBX picture [H, W, 4] that is zero outside ``box`` (x, y, width, height).

    Its coefficients are those of the codec for the whole picture. None where that would not be faster.
    """
    height, width = image.shape[:2]
    columns, lines = -(-width // _BLOCK), -(-height // _BLOCK)
    x, y, w, h = box
    left, right, top, bottom = x // _BLOCK, -(-(x + w) // _BLOCK), y // _BLOCK, -(-(y + h) // _BLOCK)
    if w < 1 or h < 1:
        left = right = top = bottom = 0
    # keep two black blocks on the left, between which words are inserted, and one on the right
    first, last = max(0, left - 2), min(columns, right + 1)
    if (last - first + _CALL_BLOCKS) * (bottom - top) > _MAX_COVERED_SHARE * columns * lines:
        return None
    header, block = _black(1, quality)
    blank = _black(columns, quality)[1]
    inserted = _word(_padding(block)) * first
    intervals = [blank] * lines
    for line in range(top, bottom):
        part = image[line * _BLOCK : (line + 1) * _BLOCK, first * _BLOCK : last * _BLOCK]
        scan = _encode(part, quality)[len(header) : -len(_END)]
        if first:
            scan = scan[: len(block)] + inserted + scan[len(block) :]
        intervals[line] = _lengthened(scan, columns - last)
    sized = bytearray(header)
    start = _marker(header, _SOF0) + 5  # height and width follow marker, length and precision
    sized[start : start + 4] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    start = _marker(header, _SOS)
    sized[start:start] = b"\xff\xdd\0\x04" + columns.to_bytes(2, "big")
    parts: list[bytes | bytearray] = [sized]
    for line, interval in enumerate(intervals):
        parts += [interval, bytes((0xFF, 0xD0 + line % 8))]
    parts[-1] = _END
    return b"".join(parts)


@lru_cache(maxsize=256)
def _black(blocks: int, quality: int) -> tuple[bytes, bytes]:
    """Return a picture's header, and the entropy-coded data of that many black blocks in a row."""
    data = _encode(np.zeros((_BLOCK, blocks * _BLOCK, 4), np.uint8), quality)
    start = _marker(data, _SOS)
    start += 2 + int.from_bytes(data[start + 2 : start + 4], "big")
    return data[:start], data[start : -len(_END)]


def _encode(image: NDArray[np.uint8], quality: int) -> bytes:
    return bytes(simplejpeg.encode_jpeg(image, quality, "RGBX", "420"))


def _padding(scan: bytes) -> int:
    """Return the number of padding bits of 1 in the last byte: coded data end with a 0."""
    return (~scan[-1] & (scan[-1] + 1)).bit_length() - 1


def _word(by: int) -> bytes:
    """Return the 32 bits of a black block after a black one, rotated by ``by`` bits."""
    return ((_BLACK << by | _BLACK >> (32 - by)) & 0xFFFFFFFF).to_bytes(4, "big")


def _lengthened(scan: bytes, blocks: int) -> bytes:
    """Append ``blocks`` black blocks to data that end with one. No byte becomes 0xFF, which JPEG would escape."""
    if not blocks:
        return scan
    padding = _padding(scan)
    ones = (1 << padding) - 1
    out = bytearray(scan) + _word(padding) * blocks
    out[len(scan) - 1] ^= ones ^ (_BLACK >> (32 - padding))  # replace the padding
    out[-1] |= ones
    return bytes(out)


def _marker(data: bytes, wanted: int) -> int:
    """Return the offset of a header segment."""
    at = 2
    while data[at + 1] != wanted:
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return at
