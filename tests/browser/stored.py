"""A backend whose pictures are ready: a person-like pair, as heavy as a real one, stamped with its frame_id."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.net.backend import Rendered, RenderJob

__all__ = ["COLUMNS", "PAIRS", "ROWS", "SQUARE", "Picture", "StoredPairs", "stamp"]

Picture = NDArray[np.uint8]

PAIRS = 16
SQUARE = 16  # pixels of one bit: whole blocks of the codec, so that it survives any quality
COLUMNS, ROWS = 6, 4  # 19 bits of frame_id, one of the eye, four that make black or grey no stamp


class StoredPairs:
    """Answers every request at once with the next of 16 pairs; ``paint(images, request)`` may draw over it.

    Pictures are [V, H, W, 4] RGBA, premultiplied, with the stamp in the upper left corner.
    """

    def __init__(self, delay: float = 0.0, paint: Callable[[Picture, RenderJob], None] | None = None) -> None:
        self.delay = delay  # seconds a picture takes
        self.paint = paint
        self.requests: list[RenderJob] = []
        self._count = 0

    def open(self) -> str:
        return "stored pictures"

    def render(self, request: RenderJob) -> Rendered:
        self.requests.append(request)
        if self.delay:
            time.sleep(self.delay)
        camera = request.cameras[0]
        # the next of the 16: what was drawn before may still be with the encoder
        images = _pair(self._count % PAIRS, len(request.cameras), camera.height, camera.width)
        self._count += 1
        if self.paint is not None:
            images = images.copy()
            self.paint(images, request)
        for eye, image in enumerate(images):
            stamp(image, request.frame_id or 0, eye)
        return Rendered(images, {"total": 0.0})

    def close(self) -> None: ...


def stamp(image: Picture, frame_id: int, eye: int) -> None:
    """Write ``frame_id`` (19 bits of it) and ``eye`` as opaque black and white squares into ``image`` [H, W, 4]."""
    number = frame_id % 2**19
    check = (_folded(number, eye) ^ 10) << 20
    value = number | eye << 19 | check
    bits = np.array([255 * (value >> i & 1) for i in range(COLUMNS * ROWS)], np.uint8).reshape(ROWS, COLUMNS)
    squares = bits.repeat(SQUARE, 0).repeat(SQUARE, 1)[: image.shape[0], : image.shape[1], None]
    image[: squares.shape[0], : squares.shape[1], :3] = squares
    image[: squares.shape[0], : squares.shape[1], 3] = 255


def _folded(number: int, eye: int) -> int:
    return (number ^ number >> 4 ^ number >> 8 ^ number >> 12 ^ number >> 16 ^ 5 * eye) & 15


@cache
def _pair(index: int, views: int, height: int, width: int) -> Picture:
    """One moment of a textured person who sways, seen by each eye a little from the side."""
    rng = np.random.default_rng(7)
    fine = cv2.resize(
        rng.uniform(0.2, 1.0, (96, 96, 3)).astype(np.float32), (width, height), None, 0, 0, cv2.INTER_CUBIC
    )
    fine += rng.normal(0, 0.03, fine.shape).astype(np.float32)
    out = np.empty((views, height, width, 4), np.uint8)
    for view in range(views):
        alpha = np.zeros((height, width), np.uint8)
        shift = 0.02 * np.sin(2 * np.pi * index / PAIRS) + 0.01 * (view - (views - 1) / 2)
        # head, trunk, arms, legs: centre and radii as parts of the picture
        parts = [(0, 0.17, 0.06, 0.09), (0, 0.45, 0.12, 0.22), (-0.17, 0.42, 0.04, 0.2), (0.17, 0.42, 0.04, 0.2)]
        for x, y, a, b in [*parts, (-0.06, 0.77, 0.05, 0.2), (0.06, 0.77, 0.05, 0.2)]:
            centre = round((0.5 + x + shift) * width * 16), round(y * height * 16)
            axes = round(a * width * 16), round(b * height * 16)
            cv2.ellipse(alpha, centre, axes, 0, 0, 360, 255, -1, cv2.LINE_AA, 4)
        colour = np.clip(fine, 0, 1) * alpha[..., None]
        out[view] = np.dstack([colour.round().astype(np.uint8), alpha])
    return out
