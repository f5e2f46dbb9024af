"""Encoded: an encoded picture. A module of its own, as a process that only draws does not import the codec."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """The JPEGs of one picture, in the order of its eyes, or one coded picture of a video."""

    pictures: list[bytes]
    boxes: list[Box] | None  # the box of each JPEG in its picture, if cropped
    ms: float  # wall time of the encoding
    alphas: list[bytes] | None = None  # grey JPEGs of the accumulated alpha, if requested
    video: dict[str, Any] | None = None  # "video" of the reply; ``pictures`` then has one coded picture of all eyes
