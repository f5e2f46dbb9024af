"""``glsplat convert``: from one format of splats and avatars to another."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, losses, save, suffixes
from glsplat.formats.scene_file import upright
from glsplat.formats.transform import transformed
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

from .args import add_up

__all__ = ["EXAMPLE", "HELP", "add_arguments", "run", "turned"]

HELP = (
    f"Convert between {suffixes(last='and')} (3DGS PLY, KHR_gaussian_splatting); the output's suffix decides. "
    "With --up the output has y up."
)
EXAMPLE = "glsplat convert scene.ply scene.glb"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument("input", metavar="IN", help=f"a {suffixes()}, recognised by content")
    parser.add_argument("output", metavar="OUT", help=f"file to write, ending in {suffixes()}")
    add_up(parser)
    parser.add_argument("--strict", action="store_true", help="refuse a file with NaN or infinity")


def run(args: argparse.Namespace) -> int:
    """Convert one file; what the output's format cannot hold is said on stderr. Raises FormatError."""
    if not Path(args.input).exists():
        raise FormatError(f"{args.input}: no such file; give a {suffixes()}")
    scene = turned(load(args.input, strict=args.strict), args.up)
    save(scene, args.output)
    for loss in losses(scene, args.output):
        print(f"glsplat convert: {args.output}: {loss}", file=sys.stderr)
    return 0


def turned(scene: Splats | Avatar, up: str) -> Splats | Avatar:
    """The scene turned for good, so that the axis ``up`` becomes y: means, rotations, colours' directions, the rig."""
    turn = upright(up)
    if not isinstance(scene, Avatar):
        return transformed(scene, turn)
    rig = scene.skeleton
    if up == "y":
        return scene
    bind = rig.inverse_bind @ turn.T
    return replace(
        scene, splats=transformed(scene.splats, turn), skeleton=Skeleton(rig.names, rig.parents, turn @ rig.rest, bind)
    )
