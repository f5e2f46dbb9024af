"""``glsplat avatar reduce``: fit an avatar of fewer splats to the pictures of another."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.data import embedded_file
from glsplat.errors import FormatError
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING, available
from glsplat.extras.authoring.finish.fitted_levels import FittedConfig, reduced
from glsplat.extras.authoring.sample.surface import MIN_SPLATS
from glsplat.formats import load_splats

from ..args import natural
from .writing import add_notes, check_name, progress_bar, write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("avatar", type=Path, help="avatar (.glb) of any source")
    parser.add_argument("-o", "--out", type=Path, required=True, help="avatar to write (.glb)")
    parser.add_argument("--splats", type=natural, required=True, help="number of Gaussians")
    parser.add_argument(
        "--steps", type=natural, default=FittedConfig().steps, help="of the fit (default %(default)d); 0: merged only"
    )
    parser.add_argument("--seed", type=natural, default=0, help="same seed, same bytes (default 0)")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    add_notes(parser)


def run(args: argparse.Namespace) -> int:
    """Fit and write; 0 on success. Raises UsageError, FormatError."""
    check_name(args.out)
    began = time.perf_counter()
    if args.steps and not available():
        raise FormatError(f"{NUMBA_MISSING}; --steps 0 merges without it")
    avatar = load_splats(embedded_file(args.avatar))
    if not isinstance(avatar, Avatar):
        raise FormatError(f"{args.avatar}: has no skeleton; reduce is for avatars, glsplat avatar levels for scenes")
    if not MIN_SPLATS <= args.splats < len(avatar.splats):
        raise FormatError(
            f"{args.avatar}: has {len(avatar.splats)} splats; --splats needs {MIN_SPLATS} or more and fewer than that, "
            f"not {args.splats}"
        )
    config = FittedConfig(steps=args.steps, splats=min(args.splats, FittedConfig().splats))
    with progress_bar() as show:
        made = reduced(avatar, args.splats, args.seed, config, show)
    return write(replace(made, meta=dict(avatar.meta)), args, began)
