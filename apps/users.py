"""``glsplat users``: manage the accounts of a server. A token is printed once; the file holds its hash."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from glsplat.errors import GlsplatError
from glsplat.extras.accounts.users import ANY, User, new_user, read_users, write_users
from glsplat.io.files import locked

from .usage import UsageError

HELP = "Add, list and remove the accounts of a server (glsplat serve --users FILE), with their avatars and rooms."
EXAMPLE = "glsplat users add ann --avatars ann,default"

_FILE = Path("users.json")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands and their options."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    add = commands.add_parser("add", help="add an account and print its token, once")
    add.add_argument("name", metavar="NAME", help="1 to 32 letters, digits or -_~; begins with a letter or digit")
    add.add_argument("--avatars", metavar="A,B", default=ANY, help="avatars it may drive (default *, all)")
    add.add_argument("--rooms", metavar="R,S", default=ANY, help="rooms it may enter (default *, all)")
    listed = commands.add_parser("list", help="list the accounts and their rights")
    remove = commands.add_parser("remove", help="remove an account; its connections end within a second")
    remove.add_argument("name", metavar="NAME")
    for command in (add, listed, remove):
        command.add_argument("--users", type=Path, default=_FILE, metavar="FILE", help=f"of accounts (default {_FILE})")


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; 0 on success. Raises GlsplatError, which names the file."""
    path: Path = args.users
    if args.action == "list":
        for user in read_users(path).values():
            print(f"{user.name}: avatars {_listed(user.avatars)}; rooms {_listed(user.rooms)}")
        return 0
    if not path.parent.is_dir():
        raise GlsplatError(f"{path}: there is no folder {path.parent}; create it first")
    with locked(path.with_name(f".{path.name}.lock"), 5.0):  # concurrent changes are not lost
        users = read_users(path) if path.exists() or args.action == "remove" else {}
        return _add(args, path, users) if args.action == "add" else _remove(args, path, users)


def _add(args: argparse.Namespace, path: Path, users: dict[str, User]) -> int:
    if args.name in users:
        raise UsageError(f"{path}: there is an account {args.name!r} already; remove it first for another token")
    user, token = new_user(args.name, _names(args.avatars), _names(args.rooms))
    write_users(path, users | {user.name: user})
    rights = f"avatars {_listed(user.avatars)}; rooms {_listed(user.rooms)}"
    print(f"{path}: {user.name}, {rights}; its token:", file=sys.stderr)
    print(token)
    return 0


def _remove(args: argparse.Namespace, path: Path, users: dict[str, User]) -> int:
    if args.name not in users:
        raise UsageError(f"{path}: there is no account {args.name!r:.50}; there are {', '.join(users) or 'none'}")
    del users[args.name]
    write_users(path, users)
    print(f"{path}: {args.name} is removed")
    return 0


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")] if text.strip() else []


def _listed(names: tuple[str, ...]) -> str:
    return "all" if ANY in names else ", ".join(names) or "none"
