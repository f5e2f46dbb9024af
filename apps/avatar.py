"""``glsplat avatar``: make an avatar from a rigged person."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from glsplat.avatar import default_avatar
from glsplat.errors import GlsplatError
from glsplat.formats import save
from glsplat.formats.files import replace_file
from glsplat.skinning.people import read_person
from glsplat.skinning.refine import RefineConfig, refine
from glsplat.skinning.surface import make_avatar

from .motion_library import library, to_json

HELP = "make avatars from rigged people"
EXAMPLE = "glsplat avatar make person.npz -o me.glb --splats 40000"

_CONSENT = "not stated"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The subcommands and their options."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    make = commands.add_parser("make", help="a rigged, textured person (.npz) to a Gaussian avatar")
    make.add_argument("person", type=Path, help="person archive (.npz): rigged mesh with textures")
    make.add_argument("-o", "--out", type=Path, required=True, help="avatar to write (.glb)")
    make.add_argument("--splats", type=int, default=40_000, help="number of Gaussians (default 40000)")
    make.add_argument("--seed", type=int, default=0, help="same seed, same bytes (default 0)")
    make.add_argument("--steps", type=int, default=RefineConfig().steps, help="fitting steps, about 1 s each; 0: none")
    for key, what in _NOTES.items():
        make.add_argument(f"--{key}", help=f"{what}, kept in the file")
    make.add_argument("--json", action="store_true", help="print what was made as JSON")

    motions = commands.add_parser("motions", help="write the motions that come with glsplat (JSON)")
    motions.add_argument("-o", "--out", type=Path, required=True, help="folder to write to")


_NOTES = {
    "source": "where the person comes from",
    "licence": "terms of use of the person's data",
    "consent": "who agreed to this likeness, or why nobody needs to",
}


def run(args: argparse.Namespace) -> int:
    """Run the chosen action; 0 on success."""
    return {"make": _make, "motions": _motions}[args.action](args)


def _make(args: argparse.Namespace) -> int:
    if args.out.suffix.lower() not in (".glb", ".gltf"):
        raise GlsplatError(f"{args.out}: an avatar is written as .glb or .gltf; change the name")
    if args.steps < 0:
        raise GlsplatError(f"--steps needs 0 or more, not {args.steps}")
    began = time.perf_counter()
    mesh = read_person(args.person)
    with tqdm(total=100, unit="%", disable=None, leave=False, bar_format="{desc}: {bar} {n:.0f} %") as bar:

        def show(stage: str, done: float) -> None:
            bar.set_description(stage)
            bar.n = 100 * done
            bar.refresh()

        avatar = make_avatar(mesh, args.splats, args.seed, progress=show)
        if args.steps:
            avatar = refine(avatar, mesh, args.seed, RefineConfig(steps=args.steps), show)
    meta: dict[str, Any] = dict(avatar.meta)
    meta["body_model"] = "SMPL-X joints (55)" if len(avatar.skeleton) == 55 else f"{len(avatar.skeleton)} joints"
    meta.setdefault("consent", _CONSENT)
    meta.update({key: getattr(args, key) for key in _NOTES if getattr(args, key)})
    avatar = replace(avatar, meta=meta)
    save(avatar, args.out)
    facts = {
        "out": str(args.out),
        "splats": len(avatar.splats),
        "bytes": args.out.stat().st_size,
        "weight_lost": round(avatar.skin.lost, 6),
        "seconds": round(time.perf_counter() - began, 1),
    }
    if args.json:
        print(json.dumps(facts))
    else:
        print(f"{args.out}: {facts['splats']} splats, {facts['bytes'] / 1e6:.2f} MB, {facts['seconds']} s")
    return 0


def _motions(args: argparse.Namespace) -> int:
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GlsplatError(f"{args.out}: cannot make the folder ({error.strerror})") from None
    for name, motion in library(default_avatar().skeleton).items():
        file = args.out / f"{name}.json"
        replace_file(file, [to_json(motion).encode()])
        print(f"{file}: {len(motion)} frames, {motion.duration:.1f} s")
    return 0
