"""Running commands in the tests' own process."""

from __future__ import annotations

import argparse
import logging
from typing import Any

import pytest

from apps.cli import main

__all__ = ["mistake", "ok", "parsed", "run"]


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
    assert code == (2 if err.endswith("--help\n") else 1), (code, out, err)
    assert out == "" and err.count("\n") == 1 and err.startswith("glsplat"), (out, err)
    return err


def parsed(command: Any, *words: object) -> argparse.Namespace:
    """The arguments of a command's module."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])
