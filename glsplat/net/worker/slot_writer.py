"""SlotWriter: the worker's side of the shared memory for pictures (slots.py)."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.net.backend import Rendered

__all__ = ["SLOTS", "SlotWriter", "mapped"]

SLOTS = 3  # one picture is drawn while two are encoded


class SlotWriter:
    """Writes the covered parts of pictures into slots."""

    def __init__(self, path: str, nbytes: int) -> None:
        with open(path, "r+b") as file:
            self._slots = mapped(file, nbytes)
        self._dirty: dict[int, NDArray[np.uint8]] = {}  # by slot: the part that its last picture covered

    def place(self, slot: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return the memory of a picture, for a backend that draws in place."""
        self._dirty[slot] = place = self._slots[slot, : int(np.prod(shape))].reshape(shape)
        return place

    def put(self, slot: int, rendered: Rendered, shape: tuple[int, ...]) -> None:
        """Zero the part that the slot's last picture covered, and copy the covered part of this one.

        Does nothing for a picture that was drawn in place. ``shape`` is that of the allocated picture.
        """
        images = rendered.images
        _, height, width, _ = images.shape
        if images.shape != shape:
            raise RuntimeError(f"pictures of shape {shape} were asked for, {images.shape} drawn")
        if images is self._dirty.get(slot):
            return
        if slot in self._dirty:
            self._dirty[slot].fill(0)
        x, y, w, h = rendered.covered or (0, 0, width, height)
        covered = self._slots[slot, : images.nbytes].reshape(images.shape)[:, y : y + h, x : x + w]
        covered[...] = images[:, y : y + h, x : x + w]
        self._dirty[slot] = covered


def mapped(file: Any, nbytes: int) -> NDArray[np.uint8]:
    """Map a file and return its slots [SLOTS, bytes]."""
    return np.frombuffer(mmap.mmap(file.fileno(), nbytes), np.uint8).reshape(SLOTS, -1)
