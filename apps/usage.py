"""Usage errors: one line with the mistake and where to find help; exit code 2."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from glsplat.errors import FormatError, GlsplatError


class UsageError(GlsplatError):
    """Invalid arguments of a command; the printed line ends with where to find help."""


class CommandParser(argparse.ArgumentParser):
    """argparse without its usage block, which buries the error under a screen of options."""

    context = ""
    """Prefix of errors: the source of the words, such as "server.toml: "; "" for the command line."""

    later: Callable[[argparse.ArgumentParser], None] | None = None
    """Adds arguments when they are first needed, so that other actions are not imported."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Add the deferred arguments, then parse as argparse does."""
        self.complete()
        return super().parse_known_args(args, namespace)

    def complete(self) -> None:
        """Add the deferred arguments."""
        later, self.later = self.later, None
        if later is not None:
            later(self)

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        text = re.sub(r"^argument ([^:]+): ", r"\1: ", message).replace("\n", " ")
        text = re.sub(r"^the following arguments are required: ", "missing: ", text)
        self.exit(2, f"{self.prog}: {self.context}{text}; see {self.prog} --help\n")


def output_kind(option: str, name: str, endings: tuple[str, ...], what: str, folder: str = "") -> str:
    """Return the suffix of an output's name, "" for a folder, after checking that it can be written.

    ``what`` describes the expected file, ``folder`` the content of a folder; without it the output is a file. Raises
    UsageError for another suffix, FormatError for a missing parent folder.
    """
    path = Path(name)
    ending = path.suffix.lower()
    is_folder = name.endswith("/") or path.is_dir()
    if is_folder and not folder:
        raise UsageError(f"{option} {name}: this is a folder; give a file in it, {what}")
    if not is_folder and ending not in endings:
        hint = f", or {name}/ for {folder}: a folder ends in /" if folder else ""
        raise UsageError(f"{option} {name}: expected {what}{hint}")
    if not path.parent.is_dir():
        raise FormatError(f"{name}: there is no folder {path.parent}; create it first")
    return "" if is_folder else ending


def make_folder(folder: Path) -> None:
    """Make a folder and its parents, if they are missing. Raises FormatError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"{folder}: cannot make the folder ({error.strerror})") from None
