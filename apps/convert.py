"""``glsplat convert``: convert splats and avatars between formats, and textured meshes to glTF."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats import save, suffixes
from glsplat.formats.registry import load
from glsplat.formats.scene_file import upright
from glsplat.formats.transform import transformed
from glsplat.light import Light
from glsplat.meshes import RiggedMesh
from glsplat.optional import plugin
from glsplat.scene import Content, Scene
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

from .args import add_up

HELP = (
    f"Convert between {suffixes(last='and', written=True)} (3DGS PLY, KHR_gaussian_splatting); "
    "the output's suffix selects the format. With --up the output has y up. "
    "Textured meshes (.glb, .gltf, .obj, a person .npz) become .glb or .gltf."
)
EXAMPLE = "glsplat convert scene.ply scene.glb"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("input", metavar="IN", help=f"a {suffixes()}, recognised by content")
    parser.add_argument("output", metavar="OUT", help=f"file to write, ending in {suffixes(written=True)}")
    add_up(parser)
    parser.add_argument("--strict", action="store_true", help="refuse a file with NaN or infinity")
    add_quiet(parser)


def run(args: argparse.Namespace) -> int:
    """Convert one file; losses are printed on stderr. Raises FormatError."""
    if not Path(args.input).exists():
        raise FormatError(f"{args.input}: no such file; give a {suffixes()}")
    found = load(args.input, strict=args.strict)
    if isinstance(found, Scene):
        raise FormatError(f"{args.input}: expected one thing, found a scene file; convert what it names")
    scene = turned(found, args.up)
    if isinstance(scene, RiggedMesh):
        save(scene, args.output)
        return 0
    save_with_report(scene, args.output, "glsplat convert", args.quiet)
    return 0


def add_quiet(parser: argparse.ArgumentParser) -> None:
    """Add --quiet."""
    parser.add_argument("--quiet", action="store_true", help="do not report losses, nor read the file back")


def save_with_report(scene: Splats | Avatar, output: str | Path, command: str, quiet: bool = False) -> None:
    """Save in the format of the suffix; print the losses, and how the file read back differs beyond rounding.

    Differences are "largest (mean)" over all splats. Raises FormatError.
    """

    def say(loss: str) -> None:
        if not quiet:
            print(f"{command}: {output}: {loss}", file=sys.stderr)

    save(scene, output, say=say)
    fidelity = None if quiet else plugin("formats.fidelity")
    if fidelity is not None and (words := ", ".join(fidelity.read_back(scene, output).words())):
        print(f"{command}: {output}: read back, off by at most (mean): {words}", file=sys.stderr)


def turned(scene: Content, up: str) -> Content:
    """Return the content rotated so that the axis ``up`` becomes y: means, rotations, SH, the rig."""
    turn = upright(up)
    if isinstance(scene, Splats):
        return transformed(scene, turn)
    if up == "y":
        return scene
    rig = scene.skeleton
    skeleton = Skeleton(rig.names, rig.parents, turn @ rig.rest, rig.inverse_bind @ turn.T)
    if isinstance(scene, RiggedMesh):
        morphs = None if scene.morphs is None else scene.morphs.turned(turn[:3, :3])
        vertices, meta = scene.vertices @ turn[:3, :3].T, _turned_meta(scene.meta, turn)
        return replace(scene, vertices=vertices, skeleton=skeleton, morphs=morphs, meta=meta)
    levels = [replace(level, content=_turned(level.content, turn, skeleton)) for level in scene.levels]
    return replace(_turned(scene, turn, skeleton), levels=tuple(levels))


def _turned(avatar: Avatar, turn: NDArray[np.float64], skeleton: Skeleton) -> Avatar:
    shapes = None if avatar.shapes is None else avatar.shapes.turned(turn[:3, :3])
    meta = _turned_meta(avatar.meta, turn)
    splats = transformed(avatar.splats, turn)
    return replace(avatar, splats=splats, skeleton=skeleton, shapes=shapes, meta=meta, levels=())


def _turned_meta(meta: Mapping[str, Any], turn: NDArray[np.float64]) -> Mapping[str, Any]:
    """Return the metadata with its estimated light rotated, which is in world axes."""
    try:
        light = Light.from_json(meta["light"]) if isinstance(meta.get("light"), Mapping) else None
    except FormatError:  # another tool's metadata of that name
        light = None
    return meta if light is None else dict(meta) | {"light": light.turned(turn[:3, :3]).to_json()}
