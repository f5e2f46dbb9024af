"""Slots: shared memory for pictures, from the process that draws to the one that encodes.

Only allocated pages are touched: writing a sparse page on a full disk would end the process by SIGBUS.
"""

from __future__ import annotations

import asyncio
import errno
import mmap
import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import ContextError, GlsplatError
from glsplat.net.worker.slot_writer import SLOTS, mapped

SHM = "/dev/shm"
_INITIAL_BYTES = 2 * 1024 * 1024 * 4  # bytes of a slot that are allocated at the start: a pair of 1024x1024


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """A slot that was handed out."""

    number: int
    picture: NDArray[np.uint8]  # [V, H, W, 4] in the slot, no copy
    give_back: Callable[[], None]  # frees the slot; on any thread, once


class Slots:
    """The server's side, which hands out slots. Each has to be given back once."""

    def __init__(self, slot_bytes: int) -> None:
        self.slot_bytes: int = _pages(slot_bytes)
        self.nbytes: int = SLOTS * self.slot_bytes
        self._file, self.folder = self._make()
        self.path: str = self._file.name
        self._slots = mapped(self._file, self.nbytes)
        self._allocated = [min(_INITIAL_BYTES, self.slot_bytes)] * SLOTS  # bytes
        self._loop: asyncio.AbstractEventLoop
        self._free: asyncio.Queue[int] = asyncio.LifoQueue()  # the newest is in the processor's cache
        for slot in range(SLOTS):
            self._free.put_nowait(slot)

    @property
    def free(self) -> int:
        """Number of slots that hold no picture."""
        return self._free.qsize()

    async def take(self, shape: tuple[int, ...]) -> Slot:
        """Wait for a free slot and allocate a picture of ``shape`` in it. Raises GlsplatError where it does not fit."""
        nbytes = int(np.prod(shape))
        if nbytes > self.slot_bytes:
            raise GlsplatError(f"{shape[2]}x{shape[1]} pixels are more than the server was started for")
        self._loop = asyncio.get_running_loop()
        slot = await self._free.get()
        allocated = self._allocated[slot]
        if nbytes > allocated:
            try:
                start = slot * self.slot_bytes + allocated
                os.posix_fallocate(self._file.fileno(), start, _pages(nbytes) - allocated)
            except OSError as error:
                self._free.put_nowait(slot)
                raise GlsplatError(
                    f"no room for a picture of {nbytes / 2**20:.1f} MiB: {_why(error, self.folder)}"
                ) from None
            self._allocated[slot] = _pages(nbytes)
        return Slot(slot, self._slots[slot, :nbytes].reshape(shape), partial(self._give_back, slot))

    def unlink(self) -> None:
        """Remove the file's name, once both sides have it open; its pages live as long as they are mapped."""
        os.unlink(self.path)

    def close(self) -> None:
        """Close the file. Pictures that are still in use stay mapped."""
        self._file.close()

    def _give_back(self, slot: int) -> None:
        with suppress(RuntimeError):  # the server has stopped
            self._loop.call_soon_threadsafe(self._free.put_nowait, slot)

    def _make(self) -> tuple[Any, str]:
        """Return a file that is allocated for ordinary pictures, in memory if it has room, and its folder."""
        failures = []
        roomy = os.path.isdir(SHM) and shutil.disk_usage(SHM).free > self.nbytes  # containers often have 64 MB there
        for folder in dict.fromkeys([*([SHM] if roomy else []), tempfile.gettempdir()]):
            file = None
            try:
                file = tempfile.NamedTemporaryFile(prefix="glsplat-", dir=folder, delete=False)
                file.truncate(self.nbytes)
                for slot in range(SLOTS):
                    os.posix_fallocate(file.fileno(), slot * self.slot_bytes, min(_INITIAL_BYTES, self.slot_bytes))
                return file, folder
            except OSError as error:
                failures.append(_why(error, folder))
                if file is not None:
                    file.close()
                    os.unlink(file.name)
        raise ContextError(f"no room for pictures in memory or on disk: {'; '.join(failures)}; free some space there")


def _pages(nbytes: int) -> int:
    return -(-nbytes // mmap.PAGESIZE) * mmap.PAGESIZE


def _why(error: OSError, folder: str) -> str:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    return f"{folder} is full" if full else f"{folder}: {error.strerror}"
