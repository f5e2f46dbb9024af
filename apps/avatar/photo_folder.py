"""``glsplat avatar photo DIR``: make an avatar of each picture in a folder, locally or on a Ray cluster."""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
from collections.abc import Callable, Iterator
from copy import copy
from pathlib import Path

from glsplat.errors import FormatError, GlsplatError

from ..ray_tasks import on_ray
from ..usage import UsageError, make_folder
from .consent import sign_mine

_PICTURES = (".jpg", ".jpeg", ".png")
_ONE_PERSON = ("back", "left", "right", "mask", "back_mask", "left_mask", "right_mask", "height")

Made = tuple[int, str, str]
"""Exit code, what was printed, and the error in one line."""


def run(args: argparse.Namespace, one: Callable[[argparse.Namespace], int]) -> int:
    """Make an avatar NAME.glb in --out of each NAME.jpg or .png; return 1 if one failed.

    ``one`` makes one avatar. Raises UsageError for options of one person, FormatError for no pictures.
    """
    for name in _ONE_PERSON:
        if getattr(args, name) is not None:
            raise UsageError(f"--{name.replace('_', '-')} is about one person, {args.front} is a folder: leave it out")
    pictures = sorted(path for path in args.front.iterdir() if path.suffix.lower() in _PICTURES)
    if not pictures:
        raise FormatError(f"{args.front}: expected pictures (NAME.jpg, NAME.png), found none")
    names = [path.stem for path in pictures]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise FormatError(f'{args.front}: two pictures are called "{twice}": rename one, its avatar takes the name')
    if not args.check:
        if args.out is None:
            raise UsageError("missing: -o/--out, a folder")
        make_folder(args.out)
    pieces = [(one, _of(args, path)) for path in pictures]
    failed = 0
    for count, (place, made) in enumerate(_all(pieces, args.ray), 1):
        code, output, why = made
        print(output, end="", flush=True)
        if args.mine and code == 0:
            why = _signed(args.out / f"{pictures[place].stem}.glb")
            code = 1 if why else 0
        if why:
            print(f"{pictures[place]}: {why}", file=sys.stderr)
        print(f"{count} of {len(pictures)} pictures", file=sys.stderr, flush=True)
        failed += code != 0
    return 1 if failed else 0


def _of(args: argparse.Namespace, picture: Path) -> argparse.Namespace:
    """Return the arguments of ``glsplat avatar photo`` for one picture."""
    own = copy(args)
    own.front = picture
    own.out = None if args.out is None else args.out / f"{picture.stem}.glb"
    own.mine = False  # signed here, with this computer's key, wherever it is made
    own.debug = None if args.debug is None else args.debug / picture.stem
    return own


def _signed(path: Path) -> str:
    """Sign the avatar; return the error, or "" on success."""
    try:
        sign_mine(path)
    except GlsplatError as error:
        return str(error)
    return ""


def _all(
    pieces: list[tuple[Callable[[argparse.Namespace], int], argparse.Namespace]], ray: str | None
) -> Iterator[tuple[int, Made]]:
    if ray is None:
        yield from ((place, _made(piece)) for place, piece in enumerate(pieces))
        return
    for place, made in on_ray(_made, pieces, ray):
        yield place, (1, "", str(made)) if isinstance(made, Exception) else made


def _made(piece: tuple[Callable[[argparse.Namespace], int], argparse.Namespace]) -> Made:
    one, args = piece
    output = io.StringIO()
    try:
        with contextlib.redirect_stdout(output):
            return one(args), output.getvalue(), ""
    except GlsplatError as error:
        return 1, output.getvalue(), str(error)
