"""``server.toml``: the options of ``glsplat serve`` in a file, and which of them ``--help`` shows."""

from __future__ import annotations

import argparse
import difflib
import json
import textwrap
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError

from ..usage import CommandParser, UsageError

__all__ = ["add_settings", "parsed", "written"]

MATTER = ("avatar", "room", "host", "port", "fps", "self-signed", "users", "allow-upload", "workers", "config")
"""What ``--help`` shows."""
_HERE_ONLY = ("help", "help-all", "config", "write-config")  # make no sense in the file
_ABSENT = object()
# what an option that has no default may look like
_SAMPLES = {
    "scene": "me.glb", "avatar": "ann.glb", "room": "lab:4", "size": "1024x1024", "max-per-address": 4,
    "max-cost": 5e8, "light": "day", "level": "auto", "lod-bias": 0.5, "fps": 45, "bitrate": 20,
    "calibration": "me.json",
    "allow-upload": "avatars",
    "trust": "authority.pub", "tls-cert": "cert.pem", "tls-key": "key.pem", "token-file": "token",
    "users": "users.json", "watermark": "on", "origin": "https://example.org", "allow-host": "avatars.example.org",
    "trusted-proxy": "127.0.0.1",
    "face-osc": 9000, "study": "study.toml", "participant": 7, "study-data": "data", "device": "0", "workers": "2",
    "ray-address": "auto",
}  # fmt: skip


class _HelpAll(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        for action, text in self.const.items():
            action.help = text
        parser.print_help()
        parser.exit()


def add_settings(parser: argparse.ArgumentParser) -> None:
    """--config, --write-config, --help-all, after all others: which of them --help shows is decided here."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="TOML",
        help="read options from this file, for those that are not given here; --write-config prints one",
    )
    parser.add_argument(
        "--write-config", action="store_true", help="print a server.toml with every option explained, and stop"
    )
    hidden = {}
    for name, action in _options(parser).items():
        if name not in (*MATTER, "help", "scene", "write-config"):
            hidden[action], action.help = action.help, argparse.SUPPRESS
    text = f"all {len(hidden) + len(MATTER)} options"
    parser.add_argument("--help-all", action=_HelpAll, nargs=0, const=hidden, help=text)


def parsed(parser: CommandParser, words: Sequence[str]) -> argparse.Namespace:
    """The arguments, with those of the file of --config behind those of the command line.

    An option that the command line gives is not taken from the file, lists included; ``--no-NAME`` takes back a switch
    that the file sets. Raises UsageError naming file and key, FormatError for a file that cannot be read.
    """
    options = _options(parser)
    for name, action in options.items():
        if _is_switch(action) and name not in _HERE_ONLY:
            parser.add_argument(f"--no-{name}", dest=action.dest, action="store_false", help=argparse.SUPPRESS)
    args = parser.parse_args(words)
    if args.config is None:
        return args
    of_file = _words(args.config, options, _given(parser, words, options))
    parser.context = f"{args.config}: "
    parser.parse_args(of_file)  # what is wrong there is the file's
    parser.context = ""
    return parser.parse_args([*of_file, *words])


def written(parser: argparse.ArgumentParser) -> str:
    """A file for --config: every option with what --help-all says, as a comment."""
    shown = next(action.const for action in parser._actions if isinstance(action, _HelpAll))
    lines = ["# glsplat serve --config server.toml; paths are as on the command line, which wins", ""]
    for name, action in _options(parser).items():
        if name in _HERE_ONLY:
            continue
        told = " ".join(str(shown.get(action, action.help)).split()).replace("%%", "%")
        lines += textwrap.wrap(told, 96, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)
        if action.choices is not None:
            lines.append(f"# one of {', '.join(map(str, action.choices))}")
        value = False if _is_switch(action) else action.default or _SAMPLES.get(name, action.default)
        lines += [f"#{name} = {json.dumps([value] if _is_list(action) else value)}", ""]
    return "\n".join(lines)


def _words(path: Path, options: dict[str, argparse.Action], given: set[str]) -> list[str]:
    """The file's options as a command line would have them, without those that are ``given`` there."""
    try:
        found = tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise FormatError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: this is no TOML ({' '.join(str(error).split())})") from None
    words = []
    for name, value in found.items():
        action = options.get(name)
        if action is None or name in _HERE_ONLY:
            near = difflib.get_close_matches(name, [one for one in options if one not in _HERE_ONLY], 1)
            raise UsageError(f"{path}: there is no option {name!r:.40}" + (f"; is it {near[0]}?" if near else ""))
        if _is_switch(action):
            if not isinstance(value, bool):
                raise UsageError(f"{path}: {name} needs true or false, not {json.dumps(value, default=str):.40}")
            words += [f"--{name}"] * (value and name not in given)
            continue
        values = value if _is_list(action) and isinstance(value, list) else [value]
        for one in values:
            if isinstance(one, bool) or not isinstance(one, str | int | float):
                kind = "a list of texts" if _is_list(action) else "a text or a number"
                raise UsageError(f"{path}: {name} needs {kind}, not {json.dumps(value, default=str):.40}")
        if name not in given:
            words += [f"--{name}={one}" if action.option_strings else str(one) for one in values]
    return words


def _given(parser: CommandParser, words: Sequence[str], options: dict[str, argparse.Action]) -> set[str]:
    """The options that the command line names, also where it names what is the default."""
    absent = argparse.Namespace(**{one.dest: None if _is_list(one) else _ABSENT for one in options.values()})
    seen = vars(parser.parse_args(words, absent))
    return {name for name, one in options.items() if seen[one.dest] not in (None, _ABSENT)}


def _options(parser: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """By name, as the file spells it, the scene among them. argparse has no public list of what it was given."""
    return {(action.option_strings or [action.dest])[-1].removeprefix("--"): action for action in parser._actions}


def _is_switch(action: argparse.Action) -> bool:
    return action.const is True


def _is_list(action: argparse.Action) -> bool:
    kind: Any = argparse._AppendAction
    return isinstance(action, kind)
