"""``glsplat avatar``: make, import and export avatars."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import NamedTuple, cast

from ..usage import CommandParser

HELP = "Make avatars from photographs or rigged people, import, export, score them, sign consents, write motions."
EXAMPLE = "glsplat avatar make person.npz -o me.glb --splats 40000"


class _Action(NamedTuple):
    """Help text, module and functions of an action."""

    help: str
    module: str
    add: str = "add_arguments"
    run: str = "run"


_ACTIONS = {
    "make": _Action("a rigged, textured person (.npz, .glb, .vrm) to a Gaussian avatar", "making", "add_make", "make"),
    "cones": _Action("compute visibility cones of splats, for --cull-hidden", "making", "add_cones", "cones"),
    "levels": _Action("add coarser levels of detail to a file, merged from it", "detail"),
    "reduce": _Action("an avatar with fewer splats, fitted to its own pictures", "detail", "add_reduce", "reduce"),
    "import": _Action(
        "an LHM dump, a LAM zip, an avatar of another rig, or splats on a mesh", "making", "add_import", "take"
    ),
    "photo": _Action("a photograph of a person, or several, to a Gaussian avatar", "photo"),
    "video": _Action("a video of a person who turns, or pictures from around, to a mesh", "video"),
    "export": _Action("the avatar in one pose as a static splat file", "making", "add_export", "export"),
    "score": _Action("compare an avatar with the textured mesh it was made from", "score"),
    "guide": _Action("a picture of how to take the photograph that an avatar is made from", "guide"),
    "consent": _Action("sign who is shown, who agreed, until when and who may drive", "consent"),
    "motions": _Action("write the motions that come with glsplat (JSON)", "making", "add_motions", "motions"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands. The module of an action is imported when it is chosen, as some take a second."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION", parser_class=CommandParser)
    for name, action in _ACTIONS.items():
        commands.add_parser(name, help=action.help).later = partial(_fill, action)


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; 0 on success."""
    action = _ACTIONS[args.action]
    return cast("int", _of(action, action.run)(args))


def _fill(action: _Action, parser: argparse.ArgumentParser) -> None:
    _of(action, action.add)(parser)


def _of(action: _Action, name: str) -> Callable[..., object]:
    return cast("Callable[..., object]", getattr(import_module(f".{action.module}", __package__), name))
