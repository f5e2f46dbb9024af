"""Record tracking and figures as JSON Lines on a separate thread, so a slow disk delays no picture.

Lines are neither synced nor chained; a power failure may lose some seconds. Recording leaves free disk space for the
session's log.
"""

from __future__ import annotations

import errno
import json
import logging
import queue
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

log: logging.Logger = logging.getLogger("glsplat.extras.study")

MAX_BYTES = 16 << 30  # limit of one file: 12 hours of both hands with all joints at 120 Hz
MIN_FREE_BYTES = 64 << 20  # disk space kept free: the size limit of a session's log

MAX_QUEUED = 4096  # lines: 45 seconds at 90 Hz
_DIGITS = 5  # of metres and quaternions


class Recording:
    """Appends lines with t in seconds, step, kind and values to a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lost = 0  # lines that the disk was too slow or too full for
        self._lines: queue.Queue[bytes | None] = queue.Queue(MAX_QUEUED)
        self._thread = threading.Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def add(self, t: float, step: str, kind: str, values: Mapping[str, Any]) -> None:
        """Queue a line."""
        fields = {"t": round(t, 3), "step": step, "kind": kind, "values": _rounded(values)}
        try:
            self._lines.put_nowait(json.dumps(fields, separators=(",", ":")).encode() + b"\n")
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Write the queued lines and stop."""
        self._lines.put(None)
        self._thread.join()

    def _run(self) -> None:
        logged, ended = False, False
        while not ended:
            lines = [self._lines.get()]
            while not self._lines.empty():
                lines.append(self._lines.get_nowait())
            ended = lines[-1] is None
            whole = [line for line in lines if line is not None]
            try:
                _append(self.path, b"".join(whole))
            except OSError as error:
                self.lost += len(whole)
                if not logged:
                    log.error("%s: cannot be written (%s); the session continues without it", self.path, error.strerror)
                logged = True


def _append(path: Path, data: bytes) -> None:
    """Append ``data`` completely, or raise OSError."""
    with open(path, "ab", buffering=0) as file:
        size = file.seek(0, 2)
        if size + len(data) > MAX_BYTES:
            raise OSError(errno.EFBIG, f"it has {MAX_BYTES >> 20} MiB, the most that is recorded")
        if shutil.disk_usage(path.parent).free < MIN_FREE_BYTES + len(data):
            raise OSError(errno.ENOSPC, f"the last {MIN_FREE_BYTES >> 20} MiB of the disk are kept for answers")
        if data and file.write(data) != len(data):
            file.truncate(size)
            raise OSError(errno.ENOSPC, "No space left on device")


def _rounded(value: Any) -> Any:
    """Return values with floats rounded to five decimals, NaN and infinity as None."""
    if isinstance(value, float):
        return round(value, _DIGITS) if value == value and abs(value) < 1e300 else None
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, list | tuple) else value
