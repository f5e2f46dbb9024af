"""Shared parts of the commands that make avatars: metadata options, the progress bar, and output."""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import all_formats, save, suffixes
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

from ..progress import Progress
from ..usage import UsageError

_NOTES = {
    "source": "where the person comes from",
    "licence": "terms of use of the person's data",
    "consent": "who agreed to this likeness, or why nobody needs to",
}


def add_notes(command: argparse.ArgumentParser) -> None:
    """Add --source, --licence and --consent."""
    for key, what in _NOTES.items():
        command.add_argument(f"--{key}", help=f"{what}, kept in the file")


def add_out(parser: argparse.ArgumentParser) -> None:
    """Add --out, the options of ``add_notes`` and --json."""
    parser.add_argument("-o", "--out", type=Path, required=True, help="avatar to write (.glb)")
    add_notes(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def notes_of(args: argparse.Namespace) -> dict[str, str]:
    """Return the metadata of the options of ``add_notes``."""
    return {key: getattr(args, key) for key in _NOTES if getattr(args, key)}


@contextmanager
def progress_bar() -> Iterator[Callable[[str, float], None]]:
    """Yield a function ``show(stage, share done)`` that draws a progress line on a terminal."""
    with Progress(1.0) as bar:

        def show(stage: str, done: float) -> None:
            bar.show(done, stage)

        yield show


def check_name(out: Path) -> None:
    """Raise UsageError or FormatError, before the work starts, for an output that cannot be written."""
    if not any(out.suffix.lower() in known.suffixes for known in all_formats().values() if known.rigs):
        raise UsageError(f"{out}: an avatar is written as {suffixes(rigs=True)}; change the name")
    if not out.parent.is_dir():
        raise FormatError(f"{out}: there is no folder {out.parent}; create it first")
    if out.exists() and not out.is_file():
        raise FormatError(f"{out}: exists and is not a regular file; give another name")
    if not os.access(out if out.exists() else out.parent, os.W_OK):
        raise FormatError(f"{out}: cannot be written (Permission denied)")


def write(
    made: Avatar | RiggedMesh,
    args: argparse.Namespace,
    began: float,
    more: Mapping[str, Any] | None = None,
    words: str = "",
) -> int:
    """Write an avatar or a textured mesh to --out with its metadata and print a summary; 0 on success.

    ``began`` is the start on ``time.perf_counter``; ``more`` is added for --json, ``words`` to the text.
    """
    if isinstance(made, Avatar):
        smplx = made.skeleton.names == JOINT_NAMES
        meta = dict(made.meta)
        meta.setdefault("body_model", "SMPL-X joints (55)" if smplx else f"{len(made.skeleton)} joints")
        meta.setdefault("consent", "not stated")
        save(replace(made, meta=meta | notes_of(args)), args.out)
        facts: dict[str, Any] = {"out": str(args.out), "splats": len(made.splats), "bytes": args.out.stat().st_size}
        facts |= {"weight_lost": round(made.skin.lost, 6), "weights_repaired": made.skin.repaired}
        text = f"{len(made.splats)} splats, {facts['bytes'] / 1e6:.2f} MB"
    else:
        save_gltf_mesh(replace(made, meta=dict(made.meta) | notes_of(args)), args.out)
        height, width = max((part.texture.shape[:2] for part in made.parts), key=math.prod)
        facts = {"out": str(args.out), "triangles": len(made.faces), "texture": [width, height]}
        facts["bytes"] = args.out.stat().st_size
        text = f"{len(made.faces)} triangles, {width} x {height} texels, {facts['bytes'] / 1e6:.2f} MB"
    facts["seconds"] = round(time.perf_counter() - began, 1)
    print(json.dumps(facts | dict(more or {})) if args.json else f"{args.out}: {text}, {facts['seconds']} s{words}")
    return 0
