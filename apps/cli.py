"""``glsplat COMMAND ...``: finds the command, prints expected errors as one line.

Exit codes: 0 ok, 1 failed, 2 bad usage.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import glsplat
from glsplat.errors import GlsplatError
from glsplat.optional import absent_extra

from .usage import CommandParser, UsageError

_OPTION, _NEGATIVE = re.compile("--[a-z][a-z-]*"), re.compile(r"-\.?[0-9]")


class Command(NamedTuple):
    """A command's group, one of GROUPS, and what ``--help`` says of it."""

    group: str
    text: str


GROUPS = ("Start", "Make an avatar", "Show it", "Build on it", "Measured")
"""As the parts of the site are called (mkdocs.yml)."""

# imported when called: a command should not wait for the imports of the others
COMMANDS = {
    "render": Command("Show it", "a picture, a clip or a turntable of a scene or a posed avatar"),
    "preview": Command("Show it", "a window that shows the avatar moving"),
    "serve": Command("Show it", "the headless render server"),
    "page": Command("Show it", "a folder for any file host that shows an avatar in browsers and in VR"),
    "replay": Command("Build on it", "a client that streams a motion through a server and reports latency"),
    "demo": Command("Start", "server and client together: frames per second, stage times, a contact sheet and a clip"),
    "bench": Command("Measured", "stage times, bytes and the price of each feature on this driver"),
    "avatar": Command("Make an avatar", "make, import and export avatars"),
    "users": Command("Show it", "add, list and remove the accounts of a server"),
    "models": Command("Make an avatar", "get, list and remove networks that others trained"),
    "study": Command("Measured", "a user study: design, orders, a session in VR, questionnaires, tidy tables"),
    "tracking": Command("Build on it", "head and hands to a full-body pose: derive, solve, score, show"),
    "evaluate": Command("Measured", "methods of making avatars, compared over participants: the tables of the paper"),
    "watermark": Command("Show it", "find the invisible mark in a clip: to whom a server sent it"),
    "report": Command("Measured", "error against run time, batching, what is left out, stability: HTML, plots, JSON"),
    "inspect": Command("Make an avatar", "what is in a scene or avatar file"),
    "convert": Command("Make an avatar", "from one format of splats and avatars to another"),
}

NEXT = """glsplat: animatable 3D Gaussian avatars for VR on plain OpenGL. What next?

  glsplat demo                              a person moves in both eyes: rates, stage times, a clip in out/demo
  glsplat serve                             then open the address that it prints, in a browser or a headset
  glsplat avatar photo me.jpg -o me.glb     an avatar of a photograph; glsplat serve me.glb shows it

All commands: glsplat --help. Each explains itself: glsplat COMMAND --help.
"""
"""What ``glsplat`` alone prints."""

_FOLDERS = ("avatar", "evaluate", "preview", "replay", "report", "serve", "study", "tracking", "users", "watermark")
MODULES = {name: f"{name}.command" for name in _FOLDERS} | {"page": "webpage.command"}
"""Commands that are folders, or whose module is called otherwise."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the entry point of the installed ``glsplat``."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments:
        return _next_steps()
    parser = CommandParser(
        prog="glsplat",
        description="Animatable 3D Gaussian avatars for VR on plain OpenGL. "
        "Without a scene, commands use the default avatar.",
        epilog="\n\n".join(map(listed, GROUPS)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"glsplat {glsplat.__version__}")
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND", help="one of the commands below")
    if arguments and arguments[0] not in COMMANDS and arguments[0] not in ("-h", "--help", "--version"):
        near = difflib.get_close_matches(arguments[0], COMMANDS, 1)
        parser.error(
            f"{arguments[0]}: no such command" + (f"; is it {near[0]}?" if near else f"; {', '.join(COMMANDS)}")
        )
    chosen = parser.parse_args(arguments[:1])

    try:
        module, args = parsed(chosen.command, arguments[1:])
        code = int(module.run(args) or 0)
        sys.stdout.flush()  # here, where a full disk can still be reported
        return code
    except UsageError as error:
        print(f"glsplat {chosen.command}: {error}; see glsplat {chosen.command} --help", file=sys.stderr)
        return 2
    except GlsplatError as error:
        print(f"glsplat {chosen.command}: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        extra = absent_extra(error)
        if extra is None:
            raise
        print(f"glsplat {chosen.command} needs {extra}, which is not installed", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except OSError as error:  # a full disk, a lost network drive: not ours, but no reason for a traceback either
        if not isinstance(error, BrokenPipeError):  # `glsplat inspect ... | head` is no error at all
            print(f"glsplat {chosen.command}: {error.strerror or error}", file=sys.stderr)
        _forget_output()
        return 1


def parsed(name: str, words: Sequence[str]) -> tuple[ModuleType, argparse.Namespace]:
    """A command's module, and what the words behind its name say. Raises SystemExit or UsageError for mistakes."""
    module = import_module(f".{MODULES.get(name, name)}", __package__)
    command = CommandParser(
        prog=f"glsplat {name}",
        description=module.HELP,
        epilog=f"example:\n  {module.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(command)
    words = joined(words)
    return module, module.parsed(command, words) if hasattr(module, "parsed") else command.parse_args(words)


def listed(group: str) -> str:
    """The commands of one group, as ``--help`` shows them."""
    lines = [f"  {name:10} {command.text}" for name, command in COMMANDS.items() if command.group == group]
    return "\n".join([f"{group}:", *lines])


def _next_steps() -> int:
    """What somebody who gave no command is told."""
    try:
        sys.stdout.write(NEXT)
        sys.stdout.flush()
        return 0
    except OSError as error:
        if not isinstance(error, BrokenPipeError):
            print(f"glsplat: {error.strerror or error}", file=sys.stderr)
        _forget_output()
        return 1


def joined(arguments: Sequence[str]) -> list[str]:
    """``--eye -1.2,1,2`` as ``--eye=-1.2,1,2``: to argparse, what begins with a minus and is no number is an option.

    No option of ours begins with a minus and a digit. So does ``--up -y``. What follows ``--`` stays as it is.
    """
    out: list[str] = []
    for index, argument in enumerate(arguments):
        if argument == "--":
            return out + list(arguments[index:])
        axis = bool(out) and out[-1] == "--up" and argument in ("-y", "-z")
        if axis or (out and _OPTION.fullmatch(out[-1]) and _NEGATIVE.match(argument)):
            out[-1] += f"={argument}"
        else:
            out.append(argument)
    return out


def _forget_output() -> None:
    """Point a broken standard output at nothing, so that Python does not fail once more when it flushes at the end."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
