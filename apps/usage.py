"""Mistakes on the command line: one line that says what was wrong and where help is; exit code 2."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from glsplat.errors import FormatError, GlsplatError

__all__ = ["CommandParser", "UsageError", "output_kind"]


class UsageError(GlsplatError):
    """The command was given something it cannot mean; the line ends with where help is."""


class CommandParser(argparse.ArgumentParser):
    """argparse without its usage block, which buries what was wrong under a screen of options."""

    context = ""
    """What the words that are parsed come from, said first: "server.toml: "; "" for the command line."""

    later: Callable[[argparse.ArgumentParser], None] | None = None
    """Adds arguments when they are first asked for: an action that is not chosen need not be imported."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As argparse, with all arguments."""
        self.complete()
        return super().parse_known_args(args, namespace)

    def complete(self) -> None:
        """Add the arguments that come ``later``."""
        later, self.later = self.later, None
        if later is not None:
            later(self)

    def error(self, message: str) -> NoReturn:
        """Print one line, exit with 2."""
        text = re.sub(r"^argument ([^:]+): ", r"\1: ", message).replace("\n", " ")
        text = re.sub(r"^the following arguments are required: ", "missing: ", text)
        self.exit(2, f"{self.prog}: {self.context}{text}; see {self.prog} --help\n")


def output_kind(option: str, name: str, endings: tuple[str, ...], what: str, folder: str = "") -> str:
    """The ending of an output's name, "" for a folder. Refuses what could not be written before the work starts.

    ``what`` says in words what is expected. ``folder`` says what a folder holds; without it there has to be a file.
    Raises UsageError for a name that does not fit, FormatError for a place that is not there.
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
