"""``glsplat avatar make``, ``cones``, ``import``, ``export``, ``motions``: convert files of people and splats."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib import resources
from itertools import pairwise
from pathlib import Path

from glsplat.avatar import Avatar, splats_of
from glsplat.data import default_avatar, embedded_file
from glsplat.errors import FormatError
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING, available
from glsplat.extras.authoring.finish.cones import ConeConfig, with_cones, without_useless_cones
from glsplat.extras.authoring.finish.levels import MIN_LEVEL_SPLATS, with_levels
from glsplat.extras.authoring.geometry.mesh_shapes import with_shapes
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.importers.bind import bind_to_mesh, read_obj_person
from glsplat.extras.authoring.importers.lam import FOLLOW_MODES, is_lam_zip, load_lam_zip
from glsplat.extras.authoring.importers.lhm_dump import load_lhm_dump
from glsplat.extras.authoring.importers.on_smplx import on_smplx
from glsplat.extras.authoring.light.surfaces import with_surface
from glsplat.extras.authoring.optimize.mesh_fit import STEPS, fitted_to_mesh
from glsplat.extras.authoring.sample.surface import MIN_SPLATS, make_avatar
from glsplat.extras.formats.person import read_body
from glsplat.extras.rigs.meshes.rig import read_rig_map
from glsplat.formats import load_splats, save, suffixes
from glsplat.formats.motion_files import embedded_motions, load_embedded_motion
from glsplat.formats.scene_file import upright
from glsplat.formats.transform import transformed
from glsplat.io.files import naming, replace_file
from glsplat.skinning.pose import Pose, load_pose
from glsplat.splats import Level

from ..args import add_up, motion_of, whole
from ..convert import add_quiet, save_with_report
from ..usage import UsageError, make_folder
from .person import add_rig, diagnostics, is_gltf, read_any_person
from .writing import add_out, check_name, progress_bar, write


def add_make(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "person", type=Path, help="rigged, textured mesh: person archive (.npz), .glb, .gltf, .vrm, or .obj with --body"
    )
    parser.add_argument(
        "--body", type=Path, help="rigged body (.npz) that lends joints and weights to an .obj in T-pose"
    )
    add_rig(parser)
    parser.add_argument("--splats", type=int, default=40_000, help="number of Gaussians (default 40000)")
    parser.add_argument("--seed", type=int, default=0, help="same seed, same bytes (default 0)")
    parser.add_argument(
        "--steps",
        type=whole(0),
        default=STEPS,
        help="of fitting all parameters of the splats, a minute for the default %(default)d; 0: none",
    )
    parser.add_argument(
        "--levels",
        nargs="+",
        metavar="N",
        help=f"splats of coarser levels of detail (default: --splats halved down to {MIN_LEVEL_SPLATS}); none: none",
    )
    parser.add_argument("--no-surface", action="store_true", help="store no surface: --light has no effect")
    parser.add_argument("--no-cones", action="store_true", help="store no visibility cones (--cull-hidden needs them)")
    add_out(parser)


def add_cones(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("scene", type=Path, help="avatar or static splats")
    parser.add_argument("-o", "--out", type=Path, required=True, help=f"file to write ({suffixes(rigs=True)})")
    parser.add_argument(
        "--psnr", type=float, default=ConeConfig().psnr, help="dB that test pictures keep (default %(default)g)"
    )
    parser.add_argument(
        "--directions", type=whole(8, 4096), default=ConeConfig().directions, help="views a pose (default %(default)d)"
    )


def add_import(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "dump",
        type=Path,
        help="lhm_dump.npz, a LAM .zip, an avatar (.glb) of another rig, which is put onto SMPL-X's joints, or a "
        "file of splats of any format with --mesh",
    )
    parser.add_argument(
        "--rig-map", type=Path, metavar="JSON", help="of an avatar of another rig: its joints by SMPL-X's names"
    )
    parser.add_argument(
        "--mesh", type=Path, help="rigged mesh in the same pose and place (.npz, .glb), for its weights"
    )
    parser.add_argument(
        "--follow",
        choices=FOLLOW_MODES,
        help="what moves a LAM zip's splats: their vertices' weights (default), or all the head, as LAM's own viewer",
    )
    parser.add_argument("--reach", type=float, default=5.0, help="cm a splat may lie off the mesh (default 5)")
    add_out(parser)


def add_export(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("avatar", nargs="?", type=Path, help="avatar (.glb); default: the embedded one")
    parser.add_argument("--pose", help="pose or motion file, or the name of an embedded motion (default: zero pose)")
    parser.add_argument("--at", type=float, default=0.0, help="seconds into a motion (default 0)")
    parser.add_argument("-o", "--out", type=Path, required=True, help=f"file to write ({suffixes(written=True)})")
    add_up(parser, "the axis that points up in the written file; viewers differ")
    add_quiet(parser)


def add_motions(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder to write to")


def make(args: argparse.Namespace) -> int:
    """Make an avatar of a rigged person, with its levels, surface and cones."""
    check_name(args.out)
    if args.splats < MIN_SPLATS:
        raise FormatError(f"an avatar needs at least {MIN_SPLATS} splats, not {args.splats}")
    counts = counts_of(args.levels, args.splats)
    began = time.perf_counter()
    if args.body is None:
        mesh = read_any_person(args.person, args)
    else:
        mesh = read_obj_person(args.person, read_body(args.body))
    if args.steps and not available():
        print(f"glsplat avatar make: {NUMBA_MISSING}", file=sys.stderr)
    reported: list[str] = []
    _report(args.person, diagnostics(mesh, scale=args.extra_scale), reported)  # before the long computation
    with progress_bar() as show:
        avatar = make_avatar(mesh, args.splats, args.seed, progress=show)
        if args.steps:
            avatar = fitted_to_mesh(avatar, mesh, args.seed, args.steps, show)
        if counts:
            avatar = with_levels(avatar, counts, args.seed, progress=show)
        if not args.no_surface:
            show("finding the surface", 0.0)
            avatar = with_surface(avatar, mesh)
        if not args.no_cones:
            avatar = without_useless_cones(with_cones(avatar, progress=show))
    _report(args.person, diagnostics(mesh, avatar, args.splats, args.extra_scale), reported)
    return write(avatar, args, began)


def _report(path: Path, lines: Iterable[str], reported: list[str]) -> None:
    """Print the lines that are not in ``reported`` on stderr, and add them to it."""
    with naming(path):
        for line in lines:
            if line not in reported:
                print(f"glsplat avatar: {path}: {line}", file=sys.stderr)
                reported.append(line)


def cones(args: argparse.Namespace) -> int:
    """Compute the visibility cones of a file."""
    check_name(args.out)
    if not 0 < args.psnr <= 100:
        raise UsageError(f"--psnr needs decibels above 0 and at most 100, not {args.psnr:g}")
    began = time.perf_counter()
    with progress_bar() as show:
        made = with_cones(load_splats(args.scene), ConeConfig(psnr=args.psnr, directions=args.directions), show)
    save(made, args.out)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.2f} MB, {time.perf_counter() - began:.1f} s")
    return 0


def take(args: argparse.Namespace) -> int:
    """Import an avatar of another program."""
    check_name(args.out)
    began = time.perf_counter()
    if args.dump.suffix.lower() == ".zip" or is_lam_zip(args.dump):
        if args.rig_map is not None:
            raise UsageError(f"{args.dump}: import the zip first, then its avatar (.glb) with --rig-map")
        if args.mesh is not None:
            raise UsageError(f"{args.dump}: a LAM zip brings its own mesh; leave out --mesh")
        return write(load_lam_zip(args.dump, follow=args.follow or FOLLOW_MODES[0]), args, began)
    if args.follow is not None:
        raise UsageError(f"{args.dump}: --follow is for LAM zips; leave it out")
    if args.mesh is None and is_gltf(args.dump):
        scene = load_splats(args.dump)
        if scene.levels:
            print(f"glsplat avatar: {args.dump}: coarser levels of detail are left out", file=sys.stderr)
        if not isinstance(scene, Avatar):
            raise FormatError(f"{args.dump}: has no skeleton; --mesh names a rigged mesh that lends one")
        with naming(args.dump):
            made = on_smplx(scene, None if args.rig_map is None else read_rig_map(args.rig_map))
        return write(made, args, began)
    if args.rig_map is not None:
        raise UsageError(f"{args.dump}: --rig-map is for an avatar (.glb) of another rig; leave it out")
    if args.mesh is None:
        return write(load_lhm_dump(args.dump), args, began)
    if not 0 < args.reach < 1000:
        raise UsageError(f"--reach needs centimetres above 0, not {args.reach:g}")
    splats = splats_of(load_splats(args.dump))
    try:
        mesh = read_any_person(args.mesh)
        avatar = with_shapes(bind_to_mesh(splats, mesh, args.reach / 100), mesh)
    except FormatError as error:
        text = str(error)
        raise FormatError(text if text.startswith(str(args.mesh)) else f"{args.dump}: {text}") from None
    return write(replace(avatar, meta={**avatar.meta, "source": args.dump.name}), args, began)


def export(args: argparse.Namespace) -> int:
    """Write an avatar in one pose."""
    scene = default_avatar() if args.avatar is None else load_splats(embedded_file(args.avatar))
    if not isinstance(scene, Avatar):
        raise FormatError(f"{args.avatar}: has no skeleton to pose; give an avatar (.glb with a skin)")
    pose = Pose.zero(len(scene.skeleton))
    if args.pose is not None:
        if not math.isfinite(args.at):
            raise UsageError(f"--at needs a number of seconds, not {args.at}")
        if _is_single_pose(args.pose):
            pose = load_pose(args.pose, scene.skeleton)
        else:
            pose = motion_of(args.pose, scene.skeleton, "--pose").at(args.at)
    levels = tuple(Level(posed_splats(one.content, pose), one.density, one.psnr) for one in scene.levels)
    posed = replace(posed_splats(scene, pose), levels=levels)
    splats = transformed(posed, upright(args.up).T)  # from y up to the file's axis
    save_with_report(splats, args.out, "glsplat avatar export", args.quiet)
    print(f"{args.out}: {len(scene.splats)} splats")
    return 0


def _is_single_pose(path: str) -> bool:
    """Return whether a file is a pose object, not a motion or frames of a video."""
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8")) if path.lower().endswith(".json") else None
    except (OSError, ValueError, RecursionError):
        return False  # the motion reader raises the error
    return isinstance(data, dict) and not {"frames", "focal"} & data.keys()


def motions(args: argparse.Namespace) -> int:
    """Write the embedded motions."""
    make_folder(args.out)
    for name in embedded_motions():
        file = args.out / f"{name}.json"
        replace_file(file, [resources.files("glsplat.data").joinpath(file.name).read_bytes()])
        motion = load_embedded_motion(name, default_avatar().skeleton)
        print(f"{file}: {len(motion)} frames, {motion.duration:.1f} s")
    return 0


def counts_of(requested: Sequence[str] | None, splats: int) -> tuple[int, ...]:
    """Return the splat counts of the coarser levels: halves by default, () for ``none``. Raises UsageError."""
    if requested is None:
        halves = [splats >> k for k in range(1, 32)]
        return tuple(half for half in halves if half >= MIN_LEVEL_SPLATS)
    if list(requested) in (["none"], ["0"]):
        return ()
    counts = [int(word) if word.isascii() and word.isdigit() else 0 for word in requested]
    if not counts or min(counts) < MIN_SPLATS or any(few >= many for many, few in pairwise((splats, *counts))):
        raise UsageError(
            f"--levels needs falling numbers of splats below {splats}, none under {MIN_SPLATS}, or none; "
            f"not {' '.join(requested) or 'nothing'}"
        )
    return tuple(counts)
