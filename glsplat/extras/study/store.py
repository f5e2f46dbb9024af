"""A participant's folder: append-only JSON Lines, each synced to disk before it is acknowledged, and chained.

``session.jsonl`` is authoritative. A line has ``n`` (from 0), ``t``, ``step``, ``kind``, ``values`` and ``sum``: the
first 32 hex digits of SHA-256 over the previous line's sum and this line without its own, so changed, removed and
inserted lines are found. Files of any size are read line by line. A torn end was never acknowledged: opening the file
for writing cuts it off and counts it.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, BinaryIO

from glsplat.errors import FormatError
from glsplat.extras.study.plan import label
from glsplat.extras.study.session import Event
from glsplat.io.files import locked, naming, open_regular

SESSION, TRACKING, FRAMES = "session.jsonl", "tracking.jsonl", "frames.jsonl"
_LOCK = ".lock"
_KEYS = ("n", "t", "step", "kind", "values", "sum")
MAX_LINE_BYTES = 1 << 20
"""Limit of one line; a consent text of 20,000 characters takes a quarter of it."""


class Log:
    """Iterates over the events of a session's file; none if it is missing.

    After iteration: the ``count`` of events, the last line's ``sum``, the ``whole`` bytes and the ``torn`` ones after
    them. Iterating raises FormatError naming the line where the chain breaks.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sum = ""
        self.count = self.whole = self.torn = 0

    def __iter__(self) -> Iterator[Event]:
        self.sum, self.count, self.whole, self.torn = "", 0, 0, 0
        if not self.path.exists():
            return
        with open_regular(self.path) as (file, _):
            lines = lines_of(file)
            for line in lines:
                event, sum_ = _parsed(line, self.count, self.sum)
                if event is None:
                    self.torn = self._end(itertools.chain([line], lines))
                    return
                self.sum, self.count, self.whole = sum_, self.count + 1, self.whole + len(line)
                yield event

    def _end(self, rest: Iterator[bytes]) -> int:
        """Return the number of torn bytes. Raises FormatError if they include a whole line."""
        torn = 0
        for line in rest:
            if _is_whole(line):
                raise FormatError(
                    f"{self.path}: line {self.count + 1}: does not follow from the lines before: the file was "
                    "changed or damaged; restore a copy"
                )
            torn += len(line)
        return torn


def lines_of(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file with their ends; lines longer than MAX_LINE_BYTES come in pieces."""
    return iter(lambda: file.readline(MAX_LINE_BYTES), b"")


class Store:
    """The only writer of a participant's folder, which is created. Raises FormatError if another process has it.

    ``replay`` is called with each existing event, in order.
    """

    def __init__(self, data: Path, participant: int, replay: Callable[[Event], object] = lambda event: None) -> None:
        self.folder = data / label(participant)
        self._path = self.folder / SESSION
        self._stack = ExitStack()
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise FormatError(f"{self.folder}: cannot be made ({error.strerror or error})") from None
        try:
            self._stack.enter_context(locked(self.folder / _LOCK))
            log = Log(self._path)
            with naming(self._path):
                for event in log:
                    replay(event)
            self.torn, self.size = log.torn, log.whole
            self._sum, self._count, self._dirty = log.sum, log.count, log.torn > 0
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | getattr(os, "O_BINARY", 0)
            try:
                self._file = os.open(self._path, flags, 0o600)
            except OSError as error:
                raise _unwritable(self._path, error) from None
            self._stack.callback(os.close, self._file)
            self._write(b"")
            _sync_folder(self.folder)
        except BaseException:
            self._stack.close()
            raise

    def append(self, events: Sequence[Event]) -> None:
        """Write events and wait for the disk. On FormatError none of them is in the file."""
        lines, sum_ = [], self._sum
        for number, event in enumerate(events, self._count):
            line, sum_ = _line(event, number, sum_)
            if len(line) > MAX_LINE_BYTES:
                raise FormatError(f"{self._path}: a line has at most {MAX_LINE_BYTES} bytes, not {len(line)}")
            lines.append(line)
        self._write(b"".join(lines))
        self._sum, self._count = sum_, self._count + len(events)

    def close(self) -> None:
        """Release the folder."""
        self._stack.close()

    def _write(self, data: bytes) -> None:
        """Append ``data``, after cutting off the rest of a failed write."""
        try:
            if self._dirty:
                self._cut()
            if data:
                self._dirty = True
                os.lseek(self._file, self.size, os.SEEK_SET)
                rest = memoryview(data)
                while len(rest):
                    rest = rest[os.write(self._file, rest) :]
                os.fsync(self._file)
                self.size, self._dirty = self.size + len(data), False
        except OSError as error:
            with suppress(OSError):  # retried before the next write and at the next opening
                self._cut()
            raise _unwritable(self._path, error) from None

    def _cut(self) -> None:
        os.ftruncate(self._file, self.size)
        os.fsync(self._file)
        self._dirty = False


def folders(data: Path) -> dict[int, Path]:
    """Return the participants' folders by number."""
    found = {}
    for path in sorted(data.glob("sub-[0-9][0-9][0-9]")):
        if path.is_dir():
            found[int(path.name[4:])] = path
    return found


def remove(data: Path, participant: int) -> int:
    """Delete a participant's data and return the number of files. Raises FormatError while a server writes there."""
    folder = data / label(participant)
    if not folder.is_dir():
        raise FormatError(f"{folder}: no data of this participant")
    with locked(folder / _LOCK):
        files = sum(path.is_file() for path in folder.rglob("*")) - 1  # the lock
        gone = folder.with_name(f".{folder.name}.deleted")  # hidden at once, even if deleting is cut short
        try:
            os.replace(folder, gone)
            shutil.rmtree(gone)
        except OSError as error:
            raise FormatError(f"{folder}: cannot be deleted completely ({error.strerror or error})") from None
        _sync_folder(data)
    return files


def _line(event: Event, number: int, before: str) -> tuple[bytes, str]:
    fields: dict[str, Any] = {"n": number, "t": round(event.t, 3), "step": event.step, "kind": event.kind}
    fields["values"] = dict(event.values)
    text = json.dumps(fields, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    chain = hashlib.sha256(f"{before}{text}".encode()).hexdigest()[:32]
    return f'{text[:-1]},"sum":"{chain}"}}\n'.encode(), chain


def _parsed(line: bytes, number: int, before: str) -> tuple[Event | None, str]:
    """Return the event of a line and its sum; None if it does not continue the chain."""
    try:
        fields = json.loads(line)
        event = Event(float(fields["t"]), str(fields["step"]), str(fields["kind"]), dict(fields["values"]))
        again, chain = _line(event, number, before)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None, ""
    return (event, chain) if again == line else (None, "")


def _is_whole(line: bytes) -> bool:
    """Return whether this is a whole line."""
    try:
        return line.endswith(b"\n") and tuple(json.loads(line)) == _KEYS
    except (ValueError, TypeError, RecursionError):
        return False


def _unwritable(path: Path, error: OSError) -> FormatError:
    return FormatError(f"{path}: cannot be written ({error.strerror or error})")


def _sync_folder(folder: Path) -> None:
    """Sync the directory entry of a new file, where the system supports it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
