"""JPEG: the eyes of a frame encoded side by side in threads, straight from the renderer's array.

simplejpeg brings its own libjpeg-turbo, releases the GIL and reads RGBA and padded rows as they lie in memory.
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

__all__ = ["Encoder", "covered_box", "encode_picture"]

_BLOCK = 16  # pixels of a 4:2:0 block: boxes on its grid do not bleed
_ALPHA_QUALITY_BONUS = (
    10  # steps of quality by which an alpha that cuts straight colours is better: all of the edge is in it
)


class Encoder:
    """A small pool of encoding threads, shared by all sessions. Close it when done."""

    def __init__(self, threads: int = 2) -> None:
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="encode")

    def encode(
        self,
        images: NDArray[np.uint8],
        quality: int = 80,
        crop: bool = False,
        covered: Box | None = None,
        alpha: bool | str = False,
    ) -> Encoded:
        """Encode ``images`` [V, H, W, 4]; blocks until all are done, so call it off the event loop.

        Outside ``covered`` the images are zero; it is not put through the codec where that saves time.
        With ``crop`` only a box of each picture is encoded: ``covered``, widened to whole blocks, or, where that is
        unknown, the box of its opaque pixels. With ``alpha`` the fourth channel too, of the same box; "straight" has
        colours that are not multiplied by it, and alpha in finer quality. The calling
        thread does the last eye itself: a pair takes one thread of the pool.
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
    """JPEG, its box if cropped, and the JPEG of its alpha."""
    box = None
    if crop:
        x, y, w, h = box = known or covered_box(image)
        image, known = image[y : y + h, x : x + w], None
    finer = 0
    if alpha == "straight":
        image, finer = straightened(image), _ALPHA_QUALITY_BONUS
    picture = None if known is None else encode_covered(image, known, quality)
    # of alpha the whole: one channel takes the codec half the time, and lines of half as many pixels save none of it
    grey = encode_picture(image[..., 3:], min(quality + finer, 100)) if alpha else None
    return picture or encode_picture(image, quality), box, grey


def encode_picture(image: NDArray[np.uint8], quality: int = 80, subsampling: str = "420") -> bytes:
    """JPEG of one picture [H, W, 1|3|4].

    Of four channels alpha is left out: the picture lies on its background already.
    """
    channels = image.shape[2]
    if image.strides[0] < 0 or image.strides[1:] != (channels, 1):  # the codec reads rows of packed pixels
        image = np.ascontiguousarray(image)
    if channels == 1:
        return bytes(simplejpeg.encode_jpeg(image, quality, "GRAY", "Gray"))
    return bytes(simplejpeg.encode_jpeg(image, quality, "RGBX" if channels == 4 else "RGB", subsampling))


def covered_box(image: NDArray[np.uint8]) -> Box:
    """The smallest box on the grid of 16 pixels that holds every pixel with alpha above zero.

    An empty picture gives its first block, because a JPEG needs at least one pixel.
    """
    height, width = image.shape[:2]
    # alpha is the highest byte of a little-endian pixel, so a row's largest pixel tells whether any alpha is above zero
    pixels = np.ascontiguousarray(image).view("<u4")[..., 0]
    rows = np.flatnonzero(pixels.max(axis=1) >> 24)
    if not len(rows):
        return 0, 0, min(_BLOCK, width), min(_BLOCK, height)
    columns = np.flatnonzero(pixels[rows[0] : rows[-1] + 1].max(axis=0) >> 24)
    x, y = columns[0], rows[0]
    return on_blocks((x, y, columns[-1] + 1 - x, rows[-1] + 1 - y), width, height)


def on_blocks(box: Box, width: int, height: int) -> Box:
    """``box`` widened to the grid of 16 pixels, inside the picture; an empty one gives a block."""
    left, top, right, bottom = box[0], box[1], box[0] + box[2], box[1] + box[3]
    x, y = min(left, width - 1) // _BLOCK * _BLOCK, min(top, height - 1) // _BLOCK * _BLOCK
    right = min(max(-(-right // _BLOCK) * _BLOCK, x + _BLOCK), width)
    bottom = min(max(-(-bottom // _BLOCK) * _BLOCK, y + _BLOCK), height)
    return int(x), int(y), int(right - x), int(bottom - y)  # numpy's integers are no JSON
