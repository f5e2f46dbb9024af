"""SlotWriter: the worker's side of the shared memory for pictures (slots.py)."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.net.backend import Rendered

SLOTS = 4  # one picture is begun while the GPU draws the one before, and two are encoded


class SlotWriter:
    """Writes the covered parts of pictures into one slot, whose ``memory`` is [bytes]."""

    def __init__(self, memory: NDArray[np.uint8]) -> None:
        self._memory = memory
        self._dirty: NDArray[np.uint8] | None = None  # the part that the last picture covered

    def place(self, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return the memory of a picture, for a backend that draws in place."""
        self._dirty = place = self._memory[: int(np.prod(shape))].reshape(shape)
        return place

    def put(self, rendered: Rendered, shape: tuple[int, ...]) -> None:
        """Zero the part that the last picture covered, and copy the covered part of this one.

        Does nothing for a picture that was drawn in place. ``shape`` is that of the allocated picture.
        """
        images = rendered.images
        _, height, width, _ = images.shape
        if images.shape != shape:
            raise RuntimeError(f"pictures of shape {shape} were requested, {images.shape} drawn")
        if images is self._dirty:
            return
        if self._dirty is not None:
            self._dirty.fill(0)
        x, y, w, h = rendered.covered or (0, 0, width, height)
        covered = self._memory[: images.nbytes].reshape(images.shape)[:, y : y + h, x : x + w]
        covered[...] = images[:, y : y + h, x : x + w]
        self._dirty = covered


def slot_writers(path: str, nbytes: int) -> list[SlotWriter]:
    """Open the file of the slots, which has ``nbytes``."""
    with open(path, "r+b") as file:
        return [SlotWriter(memory) for memory in mapped(file, nbytes)]


def mapped(file: Any, nbytes: int) -> NDArray[np.uint8]:
    """Map a file and return its slots [SLOTS, bytes]."""
    return np.frombuffer(mmap.mmap(file.fileno(), nbytes), np.uint8).reshape(SLOTS, -1)
