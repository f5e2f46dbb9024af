"""Encoder: encodes the eyes of a frame to JPEG in parallel, without a copy of the renderer's array.

simplejpeg has its own libjpeg-turbo, releases the GIL, and reads RGBA and padded rows in place.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from glsplat.net.codec.encoded import Box, Encoded
from glsplat.net.codec.partial import encode_covered
from glsplat.net.codec.straight import straightened

_BLOCK = 16  # pixels of a 4:2:0 block: boxes on its grid get no colour from outside
_ALPHA_QUALITY_BONUS = (
    10  # steps of quality by which an alpha that cuts straight colours is better: all of the edge is in it
)


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
