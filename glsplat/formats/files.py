"""Opening and replacing files: every way this can fail becomes one FormatError line that names the file."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from glsplat.errors import FormatError
from glsplat.splats import Splats

__all__ = ["checked", "naming", "open_regular", "replace_file"]


@contextmanager
def open_regular(path: str | Path) -> Iterator[tuple[BinaryIO, int]]:
    """A regular file, opened for reading, and its size in bytes.

    Raises FormatError for a directory, a pipe or device (reading one might never end), and anything the system
    refuses, also while the body of the ``with`` reads.
    """
    try:
        # O_NONBLOCK: opening a pipe without a writer would wait for one
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(descriptor, "rb") as file:
            info = os.fstat(descriptor)
            if not stat.S_ISREG(info.st_mode):
                kind = "a directory" if stat.S_ISDIR(info.st_mode) else "not a regular file"
                raise FormatError(f"{path}: expected a file, but this is {kind}")
            yield file, info.st_size
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:  # a path with a NUL byte
        raise FormatError(f"{str(path)!r}: cannot be read ({error})") from None


def replace_file(path: str | Path, parts: Iterable[bytes | memoryview]) -> None:
    """Write ``parts`` beside ``path`` and rename: the file is complete or, on any failure, as it was.

    Raises FormatError when the folder or the file cannot be written.
    """
    target = Path(path)
    if target.exists() and not target.is_file():  # renaming over a device or a folder would destroy it, or fail late
        raise FormatError(f"{path}: cannot be written (it exists and is not a regular file)")
    partial = target.parent / f".{secrets.token_hex(6)}.partial"
    try:
        try:
            with open(partial, "xb") as file:
                for part in parts:
                    file.write(part)
            os.replace(partial, target)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise FormatError(f"{path}: cannot be written ({error.strerror or error})") from None
    except ValueError as error:
        raise FormatError(f"{str(path)!r}: cannot be written ({error})") from None


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Put the file's name in front of the message of a FormatError that does not have it yet."""
    try:
        yield
    except FormatError as error:
        text = str(error)
        raise FormatError(text if text.startswith(f"{path}: ") else f"{path}: {text}") from None


def checked(splats: Splats, path: str | Path, strict: bool) -> Splats:
    """``splats`` as they are; with ``strict``, a FormatError with the count when some are not finite."""
    if strict:
        bad = len(splats) - int(splats.finite().sum())
        if bad:
            raise FormatError(
                f"{path}: {bad} of {len(splats)} splats hold NaN or infinity; repair the file or load it without strict"
            )
    return splats
