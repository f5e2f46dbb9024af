"""Encoded: one picture as it is sent. Imports little: a process that only draws does not need the codec."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = ["Box", "Encoded"]

Box = tuple[int, int, int, int]
"""x, y, width, height in pixels."""


@dataclass(frozen=True, slots=True)
class Encoded:
    """The JPEGs of one picture, in the order of its eyes, or one coded picture of a video."""

    pictures: list[bytes]
    boxes: list[Box] | None  # where each JPEG lies in its picture, if it was cropped
    ms: float  # wall time of the encoding
    alphas: list[bytes] | None = None  # grey JPEGs of the accumulated alpha, if they were asked for
    video: dict[str, Any] | None = None  # "video" of the reply; then ``pictures`` has one coded picture of all eyes
