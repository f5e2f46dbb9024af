"""Running commands in the tests' own process."""

from __future__ import annotations

import argparse
import json
import logging
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from apps.cli import main
from apps.serve.options import ServeOptions, add_options
from apps.serve.options import parsed as parsed_options
from apps.usage import CommandParser

__all__ = ["mistake", "ok", "parsed", "run", "serve_words", "serving"]

_FILED = re.compile(r"([a-z]+(?:-[a-z]+)*)=(.+)")


def run(*words: object) -> int:
    """The exit code of ``glsplat WORDS``; log records go where they went before."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    try:
        return main([str(word) for word in words])
    except SystemExit as end:  # argparse's
        return int(end.code or 0)
    finally:
        root.handlers[:] = handlers
        root.setLevel(level)
        logging.captureWarnings(False)


def ok(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """What a command that succeeds prints."""
    capsys.readouterr()
    assert run(*words) == 0
    return capsys.readouterr().out


def mistake(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one line of a command that fails; where help is, if it was used wrongly."""
    capsys.readouterr()
    code = run(*words)
    out, err = capsys.readouterr()
    assert code == (2 if err.endswith(("--help\n", "see glsplat serve --write-config\n")) else 1), (code, out, err)
    assert out == "" and err.count("\n") == 1 and err.startswith("glsplat"), (out, err)
    return err


def parsed(command: Any, *words: object) -> argparse.Namespace:
    """The arguments of a command's module."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def serve_words(folder: Path, words: Sequence[object]) -> list[str]:
    """Return ``words`` of serve; each ``name=value`` goes into an option file in ``folder``, repeated ones as lists."""
    filed: dict[str, list[str]] = {}
    rest = []
    for word in map(str, words):
        found = _FILED.fullmatch(word)
        if found is None:
            rest.append(word)
        else:
            plain = re.fullmatch(r"true|false|-?[0-9]+(\.[0-9]+)?(e[0-9]+)?", found[2])
            filed.setdefault(found[1], []).append(found[2] if plain else json.dumps(found[2]))
    if not filed:
        return rest
    path = folder / "server.toml"
    values = {name: one[0] if len(one) == 1 else f"[{', '.join(one)}]" for name, one in filed.items()}
    path.write_text("\n".join(f"{name} = {value}" for name, value in values.items()))
    return [*rest, "--config", str(path)]


def serving(*words: object) -> ServeOptions:
    """Return the options of ``glsplat serve WORDS``; ``name=value`` stands in its file."""
    parser = CommandParser(prog="glsplat serve")
    add_options(parser)
    with tempfile.TemporaryDirectory() as folder:
        return parsed_options(parser, serve_words(Path(folder), words))
