"""``glsplat avatar photo``: make an avatar or a mesh of photographs of a person, or only check them."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from glsplat.avatar import Avatar
from glsplat.errors import CaptureError, FormatError
from glsplat.extras.authoring.check.photos import CheckedPhoto, check_photos, refuse
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING, available
from glsplat.extras.authoring.compute.threads import run_in_background, share_heap
from glsplat.extras.authoring.networks import head_parts
from glsplat.extras.authoring.reconstruct.photos import (
    MeshReconstruction,
    Reconstruction,
    reconstruct,
    reconstruct_mesh,
)
from glsplat.extras.authoring.reconstruct.reconstructor import MeshReconstructor, Options, Progress
from glsplat.extras.authoring.reconstruct.registry import named, names
from glsplat.meshes import RiggedMesh
from glsplat.optional import require_package

from ..args import natural, positive
from ..output import save_png
from ..ray_tasks import add_ray
from ..usage import UsageError, make_folder
from .writing import add_notes, check_name, notes_of, progress_bar, write

_OTHERS = ("back", "left", "right")
_DEFAULT = Options()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "front",
        type=Path,
        help="the whole person from the front, best with arms off the body (.jpg, .png); or a folder of such "
        "pictures, and --out is one, too",
    )
    for side in _OTHERS:
        parser.add_argument(f"--{side}", type=Path, help=f"the same person in the same pose, seen from the {side}")
    parser.add_argument("-o", "--out", type=Path, help="avatar to write (.glb); not needed with --check")
    parser.add_argument(
        "--as",
        dest="kind",
        choices=("splats", "mesh"),
        default="splats",
        help="Gaussians, or a textured mesh that other programs open (default %(default)s)",
    )
    add_making(parser)
    parser.add_argument("--mask", type=Path, help="the person in the front picture: white on black, same size")
    for side in _OTHERS:
        parser.add_argument(f"--{side}-mask", type=Path, help=f"the same for the {side} picture")
    parser.add_argument(
        "--with",
        dest="using",
        metavar="NAME",
        default="builtin",
        help=f"what makes the avatar: {', '.join(names())} (default %(default)s; docs/photo.md)",
    )
    parser.add_argument("--check", action="store_true", help="check the pictures and make nothing")
    parser.add_argument("--anyway", action="store_true", help="use pictures that the check refuses")
    parser.add_argument(
        "--cones", action="store_true", help="make visibility cones, too (minutes; --cull-hidden needs them)"
    )
    parser.add_argument(
        "--keep-light",
        action="store_true",
        help="leave the photographs' light in the colours and say nothing of it: --light never changes this avatar",
    )
    parser.add_argument("--debug", type=Path, metavar="DIR", help="folder for a sheet that shows each step's result")
    parser.add_argument(
        "--mine",
        action="store_true",
        help="this is me, or this person agreed: sign that with a key of this computer's, made at the first use, so "
        "that 'glsplat serve' shows the avatar (docs/consent.md)",
    )
    parser.add_argument("--json", action="store_true", help="print what was found and made as JSON")
    add_ray(parser, "the pictures of a folder")
    add_notes(parser)


def add_making(parser: argparse.ArgumentParser, note: str = "") -> None:
    """Add the options that ``options_of`` reads; ``note`` begins the help of those that concern splats alone."""
    parser.add_argument("--height", type=positive, help="the person's height in metres, without shoes (1.74)")
    parser.add_argument("--splats", type=natural, help=f"{note}number of Gaussians (default {_DEFAULT.splats})")
    parser.add_argument("--seed", type=natural, help=f"{note}same seed, same bytes (default {_DEFAULT.seed})")
    steps = f"of fitting all parameters of the splats (default {_DEFAULT.steps}, 12 s for a photograph); 0: none"
    parser.add_argument("--steps", type=natural, help=note + steps)
    texture = f"with --as mesh: texels a side of the texture (default {_DEFAULT.texture})"
    parser.add_argument("--texture", type=natural, help=texture)


def run(args: argparse.Namespace) -> int:
    """Make an avatar, or one per picture. With --check return 0 for suitable pictures, else 1."""
    if args.mine and args.check:
        raise UsageError("--mine signs an avatar, --check makes none: leave one of them out")
    if args.mine:
        require_package("--mine", "cryptography", "server")  # before the work, not after it
    if args.front.is_dir():
        from . import photo_folder

        return photo_folder.run(args, _one)
    if args.ray is not None:
        raise UsageError("--ray is for a folder of pictures: one avatar is made on one machine")
    return _one(args)


def _one(args: argparse.Namespace) -> int:
    began = time.perf_counter()
    share_heap()
    if args.debug is not None:
        make_folder(args.debug)
    if args.check:
        with progress_bar() as show:
            return _report(_shots(args, show), args)
    if args.out is None:
        raise UsageError("missing: -o/--out")
    check_name(args.out)
    if args.mine and args.out.suffix.lower() != ".glb":
        raise UsageError(f"--mine: only .glb files carry a consent, not {args.out.name}; write a .glb")
    mesh = args.kind == "mesh"
    with progress_bar() as show:
        options = _options(args, show)
        if not mesh and options.steps and args.using == "builtin" and not available():
            print(f"glsplat avatar photo: {NUMBA_MISSING}", file=sys.stderr)
        maker = run_in_background(lambda: named(args.using))  # imports in the background
        # plugins are checked before the pictures
        if args.using != "builtin" and not isinstance(maker(), MeshReconstructor) and mesh:
            raise UsageError(f"--with {args.using} makes splats, no mesh: leave out --as mesh or --with")
        shots = _shots(args, show)
        done: Reconstruction | MeshReconstruction | None = None
        try:
            if not args.anyway:
                refuse(shots)
            make = reconstruct_mesh if mesh else reconstruct
            done = make(shots, options, using=args.using, anyway=True, meta=notes_of(args))
            if not args.anyway:
                refuse(shots, done.made.problem if done.made else "")
        except CaptureError as error:
            _sheet(args, shots, done)
            if args.json:
                found = [
                    {"side": side, "code": code, "kind": "refusal", "text": text} for side, code, text in error.findings
                ]
                print(json.dumps({"out": None, "findings": found}))
            hopeless = args.anyway or any(shot.capture.person is None for shot in shots.values())
            hint = "" if hopeless else "; --anyway goes on all the same"
            raise CaptureError(f"{error}{hint}", error.findings) from None
        _sheet(args, shots, done)
        made = _content(done)
        if args.cones and isinstance(made, Avatar):
            from glsplat.extras.authoring.finish.cones import with_cones

            made = with_cones(made, progress=show)
        write(made, args, began, _facts(done), _guessed(made.meta))
        if "hair" in made.meta.get("templates", {}) and not head_parts.available():
            print(f"glsplat avatar photo: {head_parts.MISSING}", file=sys.stderr)
    if args.mine:
        from .consent import sign_mine  # of another extra

        sign_mine(args.out)
    if not args.json:
        _notes(shots, guessed=True)
    return 0


def _content(done: Reconstruction | MeshReconstruction) -> Avatar | RiggedMesh:
    return done.mesh if isinstance(done, MeshReconstruction) else done.avatar


def _guessed(meta: Mapping[str, Any]) -> str:
    unseen = meta.get("unseen")
    words = "" if unseen is None else f"; {unseen:.0%} of the surface is guessed"
    return words + "".join(f"; {part}: {note}" for part, note in meta.get("templates", {}).items())


def _options(args: argparse.Namespace, show: Progress) -> Options:
    if args.cones and args.kind == "mesh":
        raise UsageError("--cones has no meaning with --as mesh: leave it out")
    if args.keep_light and args.kind == "mesh":
        raise UsageError("--keep-light has no meaning with --as mesh, which keeps it anyway: leave it out")
    return options_of(args, show, keep_light=args.keep_light)


def options_of(args: argparse.Namespace, show: Progress, **more: Any) -> Options:
    """Return the options of ``avatar photo`` and ``video``. Raises UsageError, also for one that --as excludes."""
    splats_only, mesh_only = ("splats", "seed", "steps"), ("texture",)
    values = {name: getattr(args, name) for name in ("height", *splats_only, *mesh_only)}
    values = {name: value for name, value in values.items() if value is not None}
    for name in splats_only if args.kind == "mesh" else mesh_only:
        if name in values:
            raise UsageError(f"--{name} has no meaning with --as {args.kind}: leave it out")
    try:
        return Options(**values, **more, progress=show)
    except FormatError as error:
        raise UsageError(str(error)) from None


def _shots(args: argparse.Namespace, show: Progress) -> dict[str, CheckedPhoto]:
    given = {"front": args.mask} | {side: getattr(args, f"{side}_mask") for side in _OTHERS}
    masks = {side: path for side, path in given.items() if path is not None}
    others = {side: getattr(args, side) for side in _OTHERS}
    return check_photos(args.front, **others, masks=masks, progress=show)


def _report(shots: Mapping[str, CheckedPhoto], args: argparse.Namespace) -> int:
    """Print the findings of --check; return 1 if a picture is refused."""
    good = not any(shot.capture.refused for shot in shots.values())
    _sheet(args, shots)
    if args.json:
        print(json.dumps({"good": good, "pictures": _pictures(shots)}))
        return 0 if good else 1
    for shot in shots.values():
        for finding in shot.capture.findings:
            kind = "" if finding.refusal else "note: "
            print(f"{shot.name}: {kind}{finding.code}: {finding.text}")
        if not shot.capture.refused:
            print(f"{shot.name}: will do as the {shot.side}")
    _notes(shots)
    return 0 if good else 1


def _notes(shots: Mapping[str, CheckedPhoto], guessed: bool = False) -> None:
    """Print the notes about the files, and with ``guessed`` the findings behind guessed parts."""
    for shot in shots.values():
        for finding in shot.capture.findings if guessed else ():
            print(f"{shot.name}: {finding.text}")
        for note in shot.photo.notes:
            print(f"{shot.name}: {note}")


def _pictures(shots: Mapping[str, CheckedPhoto]) -> list[dict[str, Any]]:
    return [
        {
            "side": shot.side,
            "file": shot.name,
            "size": shot.photo.size,
            "findings": [
                {"code": finding.code, "kind": finding.kind, "text": finding.text} for finding in shot.capture.findings
            ],
            "notes": shot.photo.notes,
        }
        for shot in shots.values()
    ]


def _facts(done: Reconstruction | MeshReconstruction) -> dict[str, Any]:
    """Return the command's own facts for --json."""
    facts: dict[str, Any] = {"made_by": done.made_by, "unseen": _content(done).meta.get("unseen")}
    facts["pictures"] = _pictures(done.shots)
    if done.made is not None:
        views = done.made.fit.views
        facts["stature"] = round(float(done.made.fit.stature), 4)
        facts["overlap"] = [round(view.overlap, 4) for view in views]  # with the mask, a picture each
        facts["strays"] = [round(view.landmark_error, 3) for view in views]  # of landmarks, percent of the height
        facts["doubts"] = [{limb: round(doubt, 3) for limb, doubt in view.uncertainty.items()} for view in views]
        facts["problem"] = done.made.problem
    return facts


def _sheet(
    args: argparse.Namespace, shots: Mapping[str, CheckedPhoto], done: Reconstruction | MeshReconstruction | None = None
) -> None:
    """Write the sheet of --sheet, if given."""
    if args.debug is not None:
        from . import photo_sheet

        drawn = photo_sheet.draw(shots, _content(done), done.made) if done else photo_sheet.draw(shots)
        save_png(args.debug / "photo.png", drawn)
