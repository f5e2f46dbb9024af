"""Slots: pictures in shared memory on their way from the process that draws to the one that encodes.

Only pages that were really set aside are ever touched: a page of a sparse file that cannot be had any more would end
the process by SIGBUS, without a word.
"""

from __future__ import annotations

import errno
import mmap
import os
import queue
import shutil
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.backend import Rendered

__all__ = ["SHM", "SLOTS", "SlotWriter", "Slots"]

SLOTS = 3  # pictures: one being drawn, two being encoded
SHM = "/dev/shm"
_ORDINARY = 2 * 1024 * 1024 * 4  # bytes a slot that are set aside at the start: a pair of 1024x1024
_CONTROL = mmap.PAGESIZE  # bytes in front of the slots


class Slots:
    """The side that hands slots out. Every one taken has to be given back, once."""

    def __init__(self, slot_bytes: int) -> None:
        self.slot_bytes: int = _pages(slot_bytes)
        self.nbytes: int = _CONTROL + SLOTS * self.slot_bytes
        self._file, self.folder = self._make()
        self.path: str = self._file.name
        memory = np.frombuffer(mmap.mmap(self._file.fileno(), self.nbytes), np.uint8)
        self._abandoned = memory[:4].view(np.uint32)
        self._slots = memory[_CONTROL:].reshape(SLOTS, -1)
        self._ready = [min(_ORDINARY, self.slot_bytes)] * SLOTS  # bytes that are set aside
        self._free: queue.SimpleQueue[int] = queue.SimpleQueue()
        for slot in range(SLOTS):
            self._free.put(slot)

    @property
    def free(self) -> int:
        """Slots that nobody has."""
        return self._free.qsize()

    def take(self, nbytes: int) -> int:
        """Wait for a free slot and set ``nbytes`` of it aside. Raises GlsplatError where there is no room."""
        slot = self._free.get()
        ready = self._ready[slot]
        if nbytes > ready:
            try:
                start = _CONTROL + slot * self.slot_bytes + ready
                os.posix_fallocate(self._file.fileno(), start, _pages(nbytes) - ready)
            except OSError as error:
                self._free.put(slot)
                raise GlsplatError(
                    f"no room for a picture of {nbytes / 2**20:.1f} MiB: {_why(error, self.folder)}"
                ) from None
            self._ready[slot] = _pages(nbytes)
        return slot

    def give_back(self, slot: int) -> None:
        """The slot's picture is not needed any more."""
        self._free.put(slot)

    def picture(self, slot: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """What lies in a slot."""
        return self._slots[slot, : int(np.prod(shape))].reshape(shape)

    def abandon(self, number: int) -> None:
        """Tell the other side that nobody wants picture ``number``."""
        self._abandoned[0] = number % 2**32

    def unlink(self) -> None:
        """Remove the file's name, once both sides have it open; the pages live as long as they."""
        os.unlink(self.path)

    def close(self) -> None:
        """Close the file. Pictures that are still held stay."""
        self._file.close()

    def _make(self) -> tuple[Any, str]:
        """A file with the control page and room for ordinary pictures, in memory where there is room."""
        failures = []
        roomy = os.path.isdir(SHM) and shutil.disk_usage(SHM).free > self.nbytes  # containers often have 64 MB there
        for folder in dict.fromkeys([*([SHM] if roomy else []), tempfile.gettempdir()]):
            file = None
            try:
                file = tempfile.NamedTemporaryFile(prefix="glsplat-", dir=folder, delete=False)
                file.truncate(self.nbytes)
                os.posix_fallocate(file.fileno(), 0, _CONTROL)
                for slot in range(SLOTS):
                    start = _CONTROL + slot * self.slot_bytes
                    os.posix_fallocate(file.fileno(), start, min(_ORDINARY, self.slot_bytes))
                return file, folder
            except OSError as error:
                failures.append(_why(error, folder))
                if file is not None:
                    file.close()
                    os.unlink(file.name)
        raise ContextError(f"no room for pictures in memory or on disk: {'; '.join(failures)}; free some space there")


class SlotWriter:
    """The side that draws. Of each picture only what is covered is written."""

    def __init__(self, path: str, nbytes: int) -> None:
        with open(path, "r+b") as file:
            memory = np.frombuffer(mmap.mmap(file.fileno(), nbytes), np.uint8)
        self._abandoned = memory[:4].view(np.uint32)
        self._slots = memory[_CONTROL:].reshape(SLOTS, -1)
        self._dirty: dict[int, NDArray[np.uint8]] = {}  # by slot: what its last picture covered

    def abandoned(self, number: int) -> bool:
        """True once nobody wants picture ``number``."""
        return int(self._abandoned[0]) == number % 2**32

    def place(self, slot: int, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Where the picture goes, for who can draw there."""
        self._dirty[slot] = place = self._slots[slot, : int(np.prod(shape))].reshape(shape)
        return place

    def put(self, slot: int, rendered: Rendered, shape: tuple[int, ...]) -> None:
        """Zero what the slot's last picture covered, copy what this one covers. ``shape`` is what was set aside.

        Nothing of a picture that was drawn in place.
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


def _pages(nbytes: int) -> int:
    return -(-nbytes // mmap.PAGESIZE) * mmap.PAGESIZE


def _why(error: OSError, folder: str) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return f"{folder} is full" if full else f"{folder}: {error.strerror}"
