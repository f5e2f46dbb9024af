"""Encoder: encodes the eyes of a frame to JPEG in parallel, without a copy of the renderer's array.

simplejpeg has its own libjpeg-turbo, releases the GIL, and reads RGBA and padded rows in place.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.net.codec.encoded import Box, Encoded

_BLOCK = 16  # pixels of a 4:2:0 block (minimum coded unit)
_ALPHA_QUALITY_BONUS = (
    10  # steps of quality by which an alpha that cuts straight colours is better: all of the edge is in it
)
_MAX_COVERED_SHARE = 0.8  # of the picture's blocks: above it the codec is faster with the whole picture
_CALL_BLOCKS = 15  # blocks that the codec encodes in the time that one more call takes
_SOF0, _SOS = 0xC0, 0xDA
_BLACK = 0x28A28A00  # luminance 00 (no difference) 1010 (end of block), four times; chrominance 00 00, twice
_END = b"\xff\xd9"


class Encoder:
    """A small pool of encoding threads for all sessions. Close it when done."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="encode")

    def encode(
        self,
        images: NDArray[np.uint8],
        quality: int = 80,
        crop: bool = False,
        covered: Box | None = None,
        alpha: bool | str = False,
    ) -> Encoded:
        """Encode ``images`` [V, H, W, 4], which are zero outside ``covered``. Blocks until all are done.

        With ``crop`` only a box of each picture is encoded: ``covered``, widened to whole blocks, or the box of its
        visible pixels. With ``alpha`` the fourth channel is encoded, too; "straight" divides the colours by it and
        encodes it in finer quality. The calling thread encodes the last eye: a pair takes one thread of the pool.
        """
        start = time.perf_counter()
        height, width = images.shape[1:3]
        box = None
        if covered is not None and covered[2:] != (width, height):
            box = on_blocks(covered, width, height)
        jobs = [self._pool.submit(_one, image, quality, crop, box, alpha) for image in images[:-1]]
        last = _one(images[-1], quality, crop, box, alpha)
        pictures, boxes, alphas = zip(*[job.result() for job in jobs], last, strict=True)
        return Encoded(
            list(pictures),
            [box for box in boxes if box is not None] or None,
            (time.perf_counter() - start) * 1e3,
            [grey for grey in alphas if grey is not None] if alpha else None,
        )

    def close(self) -> None:
        """Wait for running encodings and end the threads."""
        self._pool.shutdown()


def _one(
    image: NDArray[np.uint8], quality: int, crop: bool, known: Box | None, alpha: bool | str
) -> tuple[bytes, Box | None, bytes | None]:
    """Return the JPEG of an image, its box if cropped, and the JPEG of its alpha."""
    box = None
    if crop:
        x, y, w, h = box = known or covered_box(image)
        image, known = image[y : y + h, x : x + w], None
    finer = 0
    if alpha == "straight":
        image, finer = straightened(image), _ALPHA_QUALITY_BONUS
    picture = None if known is None else encode_covered(image, known, quality)
    # all of alpha: for one channel, encoding the covered lines only saves no time
    grey = encode_picture(image[..., 3:], min(quality + finer, 100)) if alpha else None
    return picture or encode_picture(image, quality), box, grey


def encode_picture(image: NDArray[np.uint8], quality: int = 80, subsampling: str = "420") -> bytes:
    """Encode a picture [H, W, 1|3|4] to JPEG. Alpha is left out: the picture is over its background already."""
    channels = image.shape[2]
    if image.strides[0] < 0 or image.strides[1:] != (channels, 1):  # the codec reads rows of packed pixels
        image = np.ascontiguousarray(image)
    if channels == 1:
        return bytes(simplejpeg.encode_jpeg(image, quality, "GRAY", "Gray"))
    return bytes(simplejpeg.encode_jpeg(image, quality, "RGBX" if channels == 4 else "RGB", subsampling))


def covered_box(image: NDArray[np.uint8]) -> Box:
    """Return the smallest box on the grid of 16 pixels that holds every pixel with alpha above zero.

    For an empty picture it is the first block, because a JPEG needs at least one pixel.
    """
    height, width = image.shape[:2]
    # alpha is the highest byte of a little-endian pixel: the largest pixel of a row has the row's largest alpha
    pixels = np.ascontiguousarray(image).view("<u4")[..., 0]
    rows = np.flatnonzero(pixels.max(axis=1) >> 24)
    if not len(rows):
        return 0, 0, min(_BLOCK, width), min(_BLOCK, height)
    columns = np.flatnonzero(pixels[rows[0] : rows[-1] + 1].max(axis=0) >> 24)
    x, y = columns[0], rows[0]
    return on_blocks((x, y, columns[-1] + 1 - x, rows[-1] + 1 - y), width, height)


def on_blocks(box: Box, width: int, height: int) -> Box:
    """Return ``box`` widened to the grid of 16 pixels, inside the picture; at least one block."""
    left, top, right, bottom = box[0], box[1], box[0] + box[2], box[1] + box[3]
    x, y = min(left, width - 1) // _BLOCK * _BLOCK, min(top, height - 1) // _BLOCK * _BLOCK
    right = min(max(-(-right // _BLOCK) * _BLOCK, x + _BLOCK), width)
    bottom = min(max(-(-bottom // _BLOCK) * _BLOCK, y + _BLOCK), height)
    return int(x), int(y), int(right - x), int(bottom - y)  # numpy's integers are no JSON


# ------------------------------------------------------------------------------------------- partly covered pictures


def encode_covered(image: NDArray[np.uint8], box: tuple[int, int, int, int], quality: int) -> bytes | None:
    """Return the baseline JPEG, 4:2:0, of an RGBX picture [H, W, 4] that is zero outside ``box`` (x, y, width, height).

    Its coefficients are those of the codec for the whole picture. None where that would not be faster.

    Each line of blocks is a restart interval (ITU-T T.81, B.2.4.4, E.1.4): it starts anew and ends on a whole byte, so
    covered lines and copies of a black one can be joined. Inside a line, a black block after a black one always takes
    the same 32 bits (Annex K's tables: no difference, end of block). Such words are inserted left and right of the
    covered part, without decoding it.
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
        scan = encode_picture(part, quality)[len(header) : -len(_END)]
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
    data = encode_picture(np.zeros((_BLOCK, blocks * _BLOCK, 4), np.uint8), quality)
    start = _marker(data, _SOS)
    start += 2 + int.from_bytes(data[start + 2 : start + 4], "big")
    return data[:start], data[start : -len(_END)]


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


# -------------------------------------------------------------------------------------------------- straight colours

_AREA = _BLOCK * _BLOCK
_OPAQUE_FROM = 32  # alpha from which a pixel's own colour counts fully: below it has few bits

_ALPHA = np.arange(256, dtype=np.float32)
_OWN_SHARE = np.minimum(_ALPHA / _OPAQUE_FROM, 1)  # weight of a pixel's own colour, by alpha
# [256] factor that makes a premultiplied colour straight, times its weight
_STRAIGHT = (_OWN_SHARE * 255 / np.maximum(_ALPHA, 1)).astype(np.float32)
_MEAN_SHARE = (1 - _OWN_SHARE).astype(np.float32)
# [256, 4]: 1 where a pixel of a block is in that quarter
_HALF = np.kron(np.eye(2), np.ones((8, 1)))  # [16, 2]
_QUARTERS = np.einsum("ya,xb->yxab", _HALF, _HALF).reshape(_AREA, 4).astype(np.float32)


def straightened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a premultiplied ``image`` [H, W, 4] with straight colours and the same alpha.

    Over black, the silhouette is the hardest edge of a picture, and JPEG's subsampled chroma smears it: the person gets
    a dark rim, the black a coloured one. Straight colours continue beyond the silhouette to the end of its block, so
    the colour has no edge there; alpha alone cuts it (docs/protocol.md).

    Pixels of little or no alpha get the mean colour of their 8x8 block, or of their 16x16 block if that is transparent.
    Transparent and opaque blocks stay as they are.
    """
    height, width = image.shape[:2]
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    out = np.zeros((rows * _BLOCK, columns * _BLOCK, 4), np.uint8)
    out[:height, :width] = image
    blocks = out.reshape(rows, _BLOCK, columns, _BLOCK, 4)
    lines = np.ascontiguousarray(out[..., 3]).reshape(rows, _BLOCK, -1)
    most, least = (of(axis=1).reshape(rows, columns, _BLOCK) for of in (lines.max, lines.min))
    row, column = np.nonzero((most.max(axis=2) > 0) & (least.min(axis=2) < 255))  # blocks on the silhouette
    pixels = blocks[row, :, column].reshape(-1, _AREA, 4).transpose(0, 2, 1).copy()  # [n, 4, 256]
    alpha, values = pixels[:, 3], pixels.astype(np.float32)
    sums = (values.reshape(-1, _AREA) @ _QUARTERS).reshape(-1, 4, 4)  # [n, channel, quarter]; one product, not n
    sums = np.where(sums[:, 3:] > 0, sums, sums.sum(axis=2, keepdims=True))
    means = (sums[:, :3] * (np.float32(255) / np.maximum(sums[:, 3:], 1))).reshape(-1, 4) @ _QUARTERS.T
    colour = values[:, :3] * _STRAIGHT[alpha][:, None]
    colour += means.reshape(-1, 3, _AREA) * _MEAN_SHARE[alpha][:, None]
    np.minimum(colour + 0.5, 255, out=colour)
    blocks[row, :, column, :, :3] = colour.astype(np.uint8).transpose(0, 2, 1).reshape(-1, _BLOCK, _BLOCK, 3)
    return out[:height, :width]
