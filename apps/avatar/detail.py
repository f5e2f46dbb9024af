"""``glsplat avatar levels`` and ``reduce``: coarser levels of detail, and avatars of fewer splats."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

from glsplat.avatar import Avatar, splats_of
from glsplat.data import embedded_file
from glsplat.errors import FormatError
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING, available
from glsplat.extras.authoring.finish.level_measure import MeasureConfig
from glsplat.extras.authoring.finish.levels import FittedConfig, reduced, with_levels
from glsplat.extras.authoring.sample.surface import MIN_SPLATS
from glsplat.formats import load_splats, save, suffixes

from ..args import natural
from ..inspect import levels_of, levels_text
from ..usage import UsageError
from .writing import add_out, check_name, progress_bar, write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("scene", type=Path, help="avatar or static splats, in any format")
    parser.add_argument("-o", "--out", type=Path, required=True, help=f"file to write ({suffixes(rigs=True)})")
    parser.add_argument(
        "--counts",
        type=int,
        nargs="+",
        metavar="N",
        help="splats of each level, falling (default: half of the finest, half of that, down to 5000)",
    )
    default = MeasureConfig().psnr
    parser.add_argument(
        "--psnr",
        type=float,
        default=default,
        help=f"dB that a level keeps where it is used (default %(default)g), or {MeasureConfig().slack:g} less",
    )
    steps = FittedConfig().steps
    parser.add_argument(
        "--steps",
        type=natural,
        default=steps,
        help=f"of fitting a level of an avatar to pictures of the finest (default {steps}; needs glsplat[make]); "
        "0: merged alone, as are levels of static scenes",
    )
    parser.add_argument("--seed", type=natural, default=0, help="same seed, same bytes (default 0)")
    parser.add_argument("--force", action="store_true", help="replace existing levels")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Make, measure and write the levels; 0 on success. Raises UsageError, FormatError."""
    check_name(args.out)
    if not 0 < args.psnr <= 100:
        raise UsageError(f"--psnr needs decibels above 0 and at most 100, not {args.psnr:g}")
    counts = args.counts
    if counts and (min(counts) < 1 or sorted(set(counts), reverse=True) != counts):
        raise UsageError(f"--counts needs falling numbers above 0, not {' '.join(map(str, counts))}")
    began = time.perf_counter()
    scene = load_splats(embedded_file(args.scene))
    if scene.levels and not args.force:
        raise FormatError(f"{args.scene}: has {len(scene.levels)} coarser levels already; --force replaces them")
    total = len(splats_of(scene))
    if counts and counts[0] >= total:
        raise FormatError(f"{args.scene}: has {total} splats; --counts needs fewer, not {counts[0]}")
    with progress_bar() as show:
        made = with_levels(scene, counts, args.seed, args.steps, MeasureConfig(psnr=args.psnr), show)
    save(made, args.out)
    levels, seconds = levels_of(made), time.perf_counter() - began
    size = args.out.stat().st_size
    if args.json:
        facts = {"out": str(args.out), "splats": total, "levels": levels, "bytes": size, "seconds": round(seconds, 1)}
        print(json.dumps(facts))
        return 0
    print(f"{args.out}: {total:,} splats, {len(levels)} coarser levels, {size / 1e6:.2f} MB, {seconds:.1f} s")
    for line in levels_text(levels) or [f"no level keeps {args.psnr:g} dB; --psnr asks for less"]:
        print(f"  {line}")
    return 0


def add_reduce(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("avatar", type=Path, help="avatar (.glb) of any source")
    parser.add_argument("--splats", type=natural, required=True, help="number of Gaussians")
    parser.add_argument(
        "--steps", type=natural, default=FittedConfig().steps, help="of the fit (default %(default)d); 0: merged only"
    )
    parser.add_argument("--seed", type=natural, default=0, help="same seed, same bytes (default 0)")
    add_out(parser)


def reduce(args: argparse.Namespace) -> int:
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
