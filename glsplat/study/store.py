"""A participant's folder: append-only JSON Lines, each line on disk before anybody hears that it is, and chained.

``session.jsonl`` has what decides: a line has ``n`` (from 0), ``t``, ``step``, ``kind``, ``values`` and ``sum``, the
first 32 hex digits of SHA-256 over the sum before and the line without its own. A line changed, left out or put in
breaks the chain. What a crash tore off at the end was never acknowledged: it is cut off, and said.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError
from glsplat.io.files import locked, open_regular
from glsplat.study.plan import label
from glsplat.study.session import Event

__all__ = ["FRAMES", "SESSION", "TRACKING", "Log", "Store", "folders", "read_log", "remove"]

SESSION, TRACKING, FRAMES = "session.jsonl", "tracking.jsonl", "frames.jsonl"
_LOCK = ".lock"
_LARGEST = 256 << 20  # bytes of a session
_KEYS = ("n", "t", "step", "kind", "values", "sum")


@dataclass(frozen=True, slots=True)
class Log:
    """The events of a session. ``whole`` bytes of the file are good, ``torn`` ones behind them are not."""

    events: tuple[Event, ...] = ()
    sum: str = ""  # of the last line
    whole: int = 0
    torn: int = 0


def read_log(path: Path) -> Log:
    """A session's file; empty where there is none. Raises FormatError naming the line at which the chain breaks."""
    if not path.exists():
        return Log()
    with open_regular(path) as (file, size):
        if size > _LARGEST:
            raise FormatError(f"{path}: expected a session of at most {_LARGEST >> 20} MiB, not {size >> 20}")
        data = file.read()
    events: list[Event] = []
    chain, at = "", 0
    while at < len(data):
        end = data.find(b"\n", at) + 1
        event, chain_after = _parsed(data[at:end], len(events), chain) if end else (None, "")
        if event is None:
            if not any(map(_is_whole, data[at:].splitlines(keepends=True))):
                return Log(tuple(events), chain, at, len(data) - at)
            raise FormatError(
                f"{path}, line {len(events) + 1}: it does not follow from the lines before: the file was changed, or "
                "the disk lost a part; take a copy back"
            )
        events.append(event)
        chain, at = chain_after, end
    return Log(tuple(events), chain, at, 0)


class Store:
    """The one writer of a participant's folder, which is made. Raises FormatError where another process has it."""

    def __init__(self, data: Path, participant: int) -> None:
        self.folder = data / label(participant)
        self._stack = ExitStack()
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        except OSError as error:
            raise FormatError(f"{self.folder}: cannot be made ({error.strerror or error})") from None
        try:
            self._stack.enter_context(locked(self.folder / _LOCK))
            log = read_log(self.folder / SESSION)
            self.events, self.torn = log.events, log.torn
            self._sum, self._size, self._count = log.sum, log.whole, len(log.events)
            self._file = _opened(self.folder / SESSION)
            self._stack.callback(os.close, self._file)
            if log.torn:
                _cut(self._file, log.whole, self.folder / SESSION)
            _sync_folder(self.folder)
        except BaseException:
            self._stack.close()
            raise

    def append(self, events: Sequence[Event]) -> None:
        """Write events and wait for the disk. Raises FormatError: none of them is in the file then."""
        lines, chain = [], self._sum
        for number, event in enumerate(events, self._count):
            line, chain = _line(event, number, chain)
            lines.append(line)
        data = b"".join(lines)
        try:
            _write_all(self._file, data, self._size)
            os.fsync(self._file)
        except OSError as error:
            with suppress(FormatError):  # what stays behind is torn, and cut off when the file is opened next
                _cut(self._file, self._size, self.folder / SESSION)
            raise FormatError(f"{self.folder / SESSION}: cannot be written ({error.strerror or error})") from None
        self._sum, self._size, self._count = chain, self._size + len(data), self._count + len(events)

    def close(self) -> None:
        """Let others have the folder."""
        self._stack.close()


def folders(data: Path) -> dict[int, Path]:
    """The participants' folders by number."""
    found = {}
    for path in sorted(data.glob("sub-[0-9][0-9][0-9]")):
        if path.is_dir():
            found[int(path.name[4:])] = path
    return found


def remove(data: Path, participant: int) -> int:
    """Delete all of a participant; returns how many files that were. Raises FormatError while a server writes there."""
    folder = data / label(participant)
    if not folder.is_dir():
        raise FormatError(f"{folder}: there is nothing of this participant")
    with locked(folder / _LOCK):
        files = sum(path.is_file() for path in folder.rglob("*")) - 1  # the lock
        gone = folder.with_name(
            f".{folder.name}.deleted"
        )  # gone at once for whoever lists, even if deleting is cut short
        try:
            os.replace(folder, gone)
            shutil.rmtree(gone)
        except OSError as error:
            raise FormatError(f"{folder}: cannot be deleted whole ({error.strerror or error})") from None
        _sync_folder(data)
    return files


def _line(event: Event, number: int, before: str) -> tuple[bytes, str]:
    fields: dict[str, Any] = {"n": number, "t": round(event.t, 3), "step": event.step, "kind": event.kind}
    fields["values"] = dict(event.values)
    text = json.dumps(fields, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    chain = hashlib.sha256(f"{before}{text}".encode()).hexdigest()[:32]
    return f'{text[:-1]},"sum":"{chain}"}}\n'.encode(), chain


def _parsed(line: bytes, number: int, before: str) -> tuple[Event | None, str]:
    """The event of a line and its sum; None where it does not follow."""
    try:
        fields = json.loads(line)
        event = Event(float(fields["t"]), str(fields["step"]), str(fields["kind"]), dict(fields["values"]))
        again, chain = _line(event, number, before)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None, ""
    return (event, chain) if again == line else (None, "")


def _is_whole(line: bytes) -> bool:
    """Whether that is a line, as opposed to a piece of one."""
    try:
        return line.endswith(b"\n") and tuple(json.loads(line)) == _KEYS
    except (ValueError, TypeError):
        return False


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | getattr(os, "O_BINARY", 0), 0o600)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None


def _write_all(file: int, data: bytes, at: int) -> None:
    os.lseek(file, at, os.SEEK_SET)
    rest = memoryview(data)
    while len(rest):
        rest = rest[os.write(file, rest) :]


def _cut(file: int, size: int, path: Path) -> None:
    try:
        os.ftruncate(file, size)
        os.fsync(file)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None


def _sync_folder(folder: Path) -> None:
    """So that a file's name is on disk, too. Where the system knows no such thing, it does so by itself."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
