"""Open, replace and lock files: every failure becomes one FormatError line that names the file.

A file is a path (str, bytes, os.PathLike), or an object that is open already, in binary mode.
"""

from __future__ import annotations

import io
import json
import logging
import os
import secrets
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO

from glsplat.errors import FormatError

Source = str | bytes | os.PathLike[Any] | BinaryIO
"""A file to read or write. An open one is read from its position to its end, and stays open."""

_IN_PLACE = (io.BytesIO, io.BufferedReader, io.BufferedRandom, io.FileIO)  # quick to seek in; others are read whole
_READ: ContextVar[tuple[str, bool]] = ContextVar("_READ", default=("", False))  # name and strictness of naming()
_BLOCKS, _BLOCK = 64, 1 << 16  # a sample of a large file: so many blocks of so many bytes


def path_of(source: Source) -> str:
    """Return a path as str. Raises FormatError for anything else, file objects among it."""
    if isinstance(source, (str, bytes, os.PathLike)):
        return os.fsdecode(source)
    raise FormatError(
        f"expected a path (str, bytes, os.PathLike) or a file open in binary mode, not {type(source).__name__}"
    )


def suffix_of(source: Source) -> str:
    """Return the suffix of a path, or of an open file's name, in lower case with its dot; "" without one."""
    return suffixes_of(source)[-1]


def suffixes_of(source: Source) -> list[str]:
    """Return all suffixes of a name, the longest first: ".compressed.ply", ".ply"; [""] without one.

    For meta.json, whose name is its format, the whole name comes first.
    """
    name = getattr(source, "name", "") if _is_open(source) else path_of(source)
    path = Path(os.fsdecode(name)) if isinstance(name, (str, bytes)) else Path()
    parts = path.suffixes
    whole = [path.name] if path.name == "meta.json" else []
    return whole + ["".join(parts[at:]).lower() for at in range(len(parts))] or [""]


def folder_of(source: Source) -> Path | None:
    """Return the folder of a path; None for an open file, whose name need not be where it lies."""
    return None if _is_open(source) else Path(path_of(source)).parent


def name_of(source: Source) -> str:
    """Return the path, or an open file's name, for messages."""
    if not _is_open(source):
        name: Any = path_of(source)
    else:
        name = getattr(source, "name", None)
        if not isinstance(name, (str, bytes)) or not name:
            return f"<{type(source).__name__}>"
    return os.fsdecode(name).encode("utf-8", "replace").decode()  # bytes that are no text cannot be printed


def _is_open(source: Source) -> bool:
    return not isinstance(source, (str, bytes, os.PathLike)) and (hasattr(source, "read") or hasattr(source, "write"))


@contextmanager
def open_regular(source: Source) -> Iterator[tuple[BinaryIO, int]]:
    """Open a regular file for reading; yield it and its size in bytes. Of an open file, the rest of it.

    Raises FormatError for a directory, a pipe or device (reading one might never end), and anything the system
    refuses, also while the body of the ``with`` reads.
    """
    name = name_of(source)
    try:
        if _is_open(source):
            yield _rest_of(source, name)  # type: ignore[arg-type]
            if isinstance(source, _IN_PLACE) and source.seekable():
                source.seek(0, os.SEEK_END)
            return
        # O_NONBLOCK: opening a pipe without a writer would wait for one
        flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        descriptor = os.open(path_of(source), flags)
        with os.fdopen(descriptor, "rb") as file:
            info = os.fstat(descriptor)
            if not stat.S_ISREG(info.st_mode):
                kind = "a directory" if stat.S_ISDIR(info.st_mode) else "not a regular file"
                raise FormatError(f"{name}: expected a file, but this is {kind}")
            yield file, info.st_size
    except IsADirectoryError:
        sog = not _is_open(source) and os.path.isfile(os.path.join(path_of(source), "meta.json"))
        more = "; of an unpacked SOG, name its meta.json" if sog else ""
        raise FormatError(f"{name}: expected a file, but this is a directory{more}") from None
    except OSError as error:
        raise FormatError(f"{name}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:  # a path with a NUL byte, a file that was closed
        raise FormatError(f"{name!r}: cannot be read ({error})") from None


def read_json(source: Source, kind: str, most: int) -> Any:
    """Return the JSON value of a file of at most ``most`` bytes; ``kind`` ("a light") is what messages call it.

    Raises FormatError.
    """
    with naming(source), open_regular(source) as (file, size):
        if size > most:
            raise FormatError(f"{kind} has at most {most} bytes, this one {size}")
        try:
            return json.loads(file.read())
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{kind} is JSON, but {error}") from None


def replace_file(target: Source, parts: Iterable[bytes | memoryview], *, private: bool = False) -> None:
    """Write ``parts`` beside the path ``target`` and rename: the file is complete or, on any failure, as it was.

    A link is followed, a file that is there keeps its mode (and owner, where the system allows), a new one gets what
    the umask says. A ``private`` one is never readable for others, whatever it was. An open file is written to from
    where it stands. Raises FormatError when this is refused.
    """
    name = name_of(target)
    try:
        if _is_open(target):
            _write_to(target, parts, name)  # type: ignore[arg-type]
        else:
            _replace(Path(os.path.realpath(path_of(target))), parts, 0o700 if private else 0o777)
    except OSError as error:
        raise FormatError(f"{name}: cannot be written ({error.strerror or error})") from None
    except ValueError as error:
        raise FormatError(f"{name!r}: cannot be written ({error})") from None


@contextmanager
def locked(path: Path, patience: float = 0.0) -> Iterator[None]:
    """Hold the lock file ``path``, which one process has at a time; wait up to ``patience`` seconds for it.

    Raises FormatError when another process keeps it. Systems without such locks have none. The file stays.
    """
    try:
        import fcntl  # not on Windows
    except ImportError:
        yield
        return
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None
    try:
        end = time.monotonic() + patience
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= end:
                    raise FormatError(f"{path}: another process holds it; end it, or try again") from None
                time.sleep(0.02)
            except OSError:  # some network file systems have none; each file is still written whole
                break
        yield
    finally:
        os.close(lock)


@contextmanager
def naming(source: Source, strict: bool = False) -> Iterator[None]:
    """Put the file's name in front of the message of a FormatError that does not have it yet.

    With ``strict``, warnings of ``left_out`` become such errors.
    """
    name = name_of(source)
    before = _READ.set((name, strict))
    try:
        yield
    except FormatError as error:
        whole, known = str(error), (f"{name}: ", f"{name!r}: ")
        said = next((start for start in known if whole.startswith(start)), "")
        text = said + printable(whole.removeprefix(said))
        raise FormatError(text if text.startswith((f"{name}: ", f"{name!r}: ")) else f"{name}: {text}") from None
    finally:
        _READ.reset(before)


def left_out(log: logging.Logger, reason: str) -> None:
    """Log a warning that names the file being read; strict reading raises a FormatError instead."""
    name, strict = _READ.get()
    if strict:
        raise FormatError(f"{reason}; repair the file or load it without strict")
    log.warning("%s: %s", name, printable(reason))


def printable(text: str) -> str:
    """Replace line breaks and control characters, which names in a file may have."""
    return "".join(c if c.isprintable() else "?" for c in text)


def sampled(file: BinaryIO, start: int, size: int, whole: int = _BLOCKS * _BLOCK) -> bytes:
    """Read ``size`` bytes from ``start``; of more than ``whole``, blocks spread evenly, at multiples of 64 bytes."""
    if size <= whole:
        file.seek(start)
        return file.read(size)
    parts = []
    for index in range(_BLOCKS):
        file.seek(start + (size - _BLOCK) * index // (_BLOCKS - 1) // 64 * 64)
        parts.append(file.read(_BLOCK))
    return b"".join(parts)


class _Rest(io.RawIOBase):
    """The rest of an open file as a file that begins at 0; closing it leaves the other open."""

    def __init__(self, file: BinaryIO, start: int, size: int) -> None:
        self._file, self._start, self._size, self._at = file, start, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = max(0, offset + (0, self._at, self._size)[whence])
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        self._file.seek(self._start + self._at)
        data = self._file.read(len(buffer))
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)


def _rest_of(file: BinaryIO, name: str) -> tuple[BinaryIO, int]:
    if isinstance(file, io.TextIOBase) or not hasattr(file, "read"):
        raise FormatError(f"{name}: expected a file open for reading in binary mode (open(..., 'rb'))")
    if isinstance(file, _IN_PLACE) and file.seekable():
        start = file.tell()
        size = file.seek(0, os.SEEK_END) - start
        file.seek(start)
        return io.BufferedReader(_Rest(file, start, max(size, 0)), _BLOCK), max(size, 0)
    try:
        data: Any = file.read()
    except (OSError, ValueError):
        raise
    except Exception as error:  # zlib.error, BadZipFile, EOFError, ...: whatever the object's own kind is
        raise FormatError(f"{name}: cannot be read ({type(error).__name__}: {error})") from error
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise FormatError(
            f"{name}: expected a file open in binary mode, whose read() gives bytes, not {type(data).__name__}"
        )
    return io.BytesIO(data), len(data)


def _write_to(file: BinaryIO, parts: Iterable[bytes | memoryview], name: str) -> None:
    if isinstance(file, io.TextIOBase) or not hasattr(file, "write"):
        raise FormatError(f"{name}: expected a file open for writing in binary mode (open(..., 'wb'))")
    for part in parts:
        rest = memoryview(part).cast("B")
        while len(rest):  # an unbuffered file may take less than it is given
            try:
                count = file.write(rest)
            except TypeError as error:
                raise FormatError(f"{name}: expected a file open in binary mode ({error})") from None
            if count == 0:
                raise FormatError(f"{name}: cannot be written (it takes no more bytes)")
            rest = rest[len(rest) if count is None else count :]


def _replace(path: Path, parts: Iterable[bytes | memoryview], most: int) -> None:
    """Write a file beside ``path`` and rename it; ``most``: mask of its mode."""
    try:
        old = os.lstat(path)
    except FileNotFoundError:
        old = None
    if old is not None:
        # renaming over a device or a folder would destroy it, or fail late; a remaining link is one of a circle
        if not stat.S_ISREG(old.st_mode):
            raise OSError("it exists and is not a regular file")
        if not os.access(path, os.W_OK):  # renaming does not check this
            raise PermissionError(13, "Permission denied")
    partial = path.parent / f".{secrets.token_hex(6)}.partial"
    try:
        with open(partial, "xb", opener=lambda name, flags: os.open(name, flags, 0o666 & most)) as file:
            for part in parts:
                file.write(part)
        if old is not None:
            if hasattr(os, "chown"):
                with suppress(OSError):  # only root may give a file away
                    os.chown(partial, old.st_uid, old.st_gid)
            os.chmod(partial, stat.S_IMODE(old.st_mode) & most)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
