"""``glsplat COMMAND ...``: run a command; print expected errors as one line.

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
    """A command's group, one of GROUPS, and its line in ``--help``."""

    group: str
    text: str


GROUPS = ("Start", "Make an avatar", "Show it", "Build on it", "Measured")
"""Groups of commands in --help."""

# a command's module is imported when it is called
COMMANDS = {
    "render": Command("Show it", "render a picture, a clip or a turntable of a scene or a posed avatar"),
    "preview": Command("Show it", "show the avatar moving in a window"),
    "serve": Command("Show it", "run the headless render server"),
    "page": Command("Show it", "write a static web page that shows an avatar in browsers and in VR"),
    "replay": Command("Build on it", "stream a motion through a server and report latency"),
    "demo": Command("Start", "run server and client: frame rates, stage times, a contact sheet and a clip"),
    "bench": Command("Measured", "measure stage times, bytes and the cost of each feature on this driver"),
    "avatar": Command("Make an avatar", "make, import and export avatars"),
    "users": Command("Show it", "add, list and remove the accounts of a server"),
    "models": Command("Make an avatar", "download, list and remove third-party networks"),
    "study": Command("Measured", "run a user study: design, orders, a session in VR, questionnaires, tidy tables"),
    "tracking": Command("Build on it", "solve a full-body pose from head and hands: derive, solve, score, show"),
    "evaluate": Command("Measured", "compare methods of making avatars over participants: the tables of the paper"),
    "watermark": Command("Show it", "find the invisible watermark of a session in a clip"),
    "selftest": Command("Measured", "hold this driver against every promise; files to attach to a report of a bug"),
    "report": Command("Measured", "report error against run time, batching, culling, stability: HTML, plots, JSON"),
    "inspect": Command("Make an avatar", "describe a scene or avatar file"),
    "convert": Command("Make an avatar", "convert splats and avatars between formats"),
}

NEXT = """glsplat: animatable 3D Gaussian avatars for VR on plain OpenGL. What next?

  glsplat demo                              a moving person for both eyes: rates, stage times, a clip in out/demo
  glsplat serve                             then open the printed address in a browser or a headset
  glsplat avatar photo me.jpg -o me.glb     make an avatar of a photograph; glsplat serve me.glb shows it

All commands: glsplat --help. Details of one: glsplat COMMAND --help.
"""
"""Printed by ``glsplat`` without a command."""

_FOLDERS = ("avatar", "evaluate", "preview", "replay", "report", "selftest", "serve", "study", "tracking")
MODULES = {name: f"{name}.command" for name in _FOLDERS} | {"page": "webpage"}
"""Modules of commands that are folders, or have another name than the command."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; the entry point of the installed ``glsplat``."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    prog, see = f"glsplat {_command(arguments)}" if arguments else "glsplat", "--help"
    try:
        if arguments:
            see = getattr(_module(arguments[0]), "SEE", see)
            module, args = parsed(arguments[0], arguments[1:])
            code = int(module.run(args) or 0)
        else:
            code = 0
            print(NEXT, end="")
        sys.stdout.flush()  # here, where a full disk can still be reported
        return code
    except UsageError as error:
        print(f"{prog}: {error}; see {prog} {see}", file=sys.stderr)
        return 2
    except GlsplatError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        extra = absent_extra(error)
        if extra is None:
            raise
        print(f"{prog} needs {extra}, which is not installed", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except OSError as error:  # a full disk, a lost network drive: no reason for a traceback
        if not isinstance(error, BrokenPipeError):  # `glsplat inspect ... | head` is no error
            print(f"{prog}: {error.strerror or error}", file=sys.stderr)
        _discard_output()
        return 1


def _command(arguments: Sequence[str]) -> str:
    """Return the name of the command. Raises SystemExit after --help, --version, or an unknown name."""
    parser = CommandParser(
        prog="glsplat",
        description="Animatable 3D Gaussian avatars for VR on plain OpenGL. "
        "Without a scene, commands use the default avatar.",
        epilog="\n\n".join(map(listed, GROUPS)),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"glsplat {glsplat.__version__}")
    parser.add_argument("command", choices=list(COMMANDS), metavar="COMMAND", help="one of the commands below")
    if arguments[0] not in COMMANDS and arguments[0] not in ("-h", "--help", "--version"):
        near = difflib.get_close_matches(arguments[0], COMMANDS, 1)
        parser.error(
            f"{arguments[0]}: no such command" + (f"; is it {near[0]}?" if near else f"; {', '.join(COMMANDS)}")
        )
    return str(parser.parse_args(arguments[:1]).command)


def _module(name: str) -> ModuleType:
    """Return a command's module. ``SEE`` in it is the flag that explains its options, if not --help."""
    return import_module(f".{MODULES.get(name, name)}", __package__)


def parsed(name: str, words: Sequence[str]) -> tuple[ModuleType, argparse.Namespace]:
    """Return a command's module and its parsed arguments. Raises SystemExit or UsageError for mistakes."""
    module = _module(name)
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
    """Return the lines of a group in ``--help``."""
    lines = [f"  {name:10} {command.text}" for name, command in COMMANDS.items() if command.group == group]
    return "\n".join([f"{group}:", *lines])


def joined(arguments: Sequence[str]) -> list[str]:
    """Join ``--eye -1.2,1,2`` to ``--eye=-1.2,1,2``, and ``--up -y``: argparse would read the value as an option.

    No option begins with a minus and a digit. Arguments after ``--`` are unchanged.
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


def _discard_output() -> None:
    """Redirect a broken standard output to the null device, so that Python's flush at exit does not fail."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    sys.exit(main())
