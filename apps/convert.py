"""``glsplat convert``: between PLY, .splat and glTF."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import load, save
from glsplat.formats.scene_file import upright
from glsplat.formats.transform import transformed
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats
from glsplat.views import splats_of

from .args import add_up

__all__ = ["EXAMPLE", "HELP", "add_arguments", "losses", "run", "turned"]

HELP = (
    "Convert between 3DGS PLY, .splat and glTF (KHR_gaussian_splatting); the output's suffix decides. "
    "With --up the output has y up."
)
EXAMPLE = "glsplat convert scene.ply scene.glb"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument("input", metavar="IN", help="PLY, .splat, .glb or .gltf, recognised by content")
    parser.add_argument("output", metavar="OUT", help="file to write, ending in .ply, .splat, .glb or .gltf")
    add_up(parser)
    parser.add_argument("--strict", action="store_true", help="refuse a file with NaN or infinity")


def run(args: argparse.Namespace) -> int:
    """Convert one file; what the output's format cannot hold is said on stderr. Raises FormatError."""
    if not Path(args.input).exists():
        raise FormatError(f"{args.input}: no such file; give a PLY, .splat or glTF")
    scene = turned(load(args.input, strict=args.strict), args.up)
    save(scene, args.output)
    for loss in losses(scene, Path(args.output).suffix.lower()):
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


def losses(scene: Splats | Avatar, suffix: str) -> Iterator[str]:
    """What a file with that suffix does not keep of ``scene``, beyond rounding, a sentence each."""
    if suffix in (".glb", ".gltf"):
        return
    if isinstance(scene, Avatar):
        yield f"the rig of {len(scene.skeleton)} joints is dropped, the file holds the zero pose"
    splats = splats_of(scene)
    if suffix == ".splat" and splats.sh_degree:
        yield f"spherical harmonics of degree {splats.sh_degree} are dropped, the file holds degree 0"
    if suffix == ".splat" and splats.antialias:
        yield "that the splats want opacity compensation is dropped; draw them with --antialias"
    if splats.cones is not None:
        yield "the visibility cones are dropped"
    with np.errstate(invalid="ignore"):
        outside = int(((splats.opacities < 0) | (splats.opacities > 1)).sum())
        negative = int((splats.scales < 0).any(axis=1).sum())
    if outside:
        yield f"{outside} opacities outside 0 to 1 are clamped"
    if negative and suffix == ".ply":
        yield f"{negative} splats with negative scales are written with positive ones (their shape is the same)"
