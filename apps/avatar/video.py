"""``glsplat avatar video``: make a mesh or an avatar of a video of a turning person, or of pictures from around."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from glsplat.errors import CaptureError
from glsplat.extras.authoring.compute.compiled import NUMBA_MISSING, available
from glsplat.extras.authoring.reconstruct.video import FORMS, FRAMES, MAX_FRAMES, VideoResult, from_video
from glsplat.extras.authoring.video.film import MIN_FRAMES

from ..args import whole
from .photo import add_making, options_of
from .writing import add_notes, check_name, notes_of, progress_bar, write


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "frames_from",
        metavar="VIDEO|PICTURE",
        type=Path,
        nargs="+",
        help="one video of a person who turns on the spot (.mp4, .mov, .webm), or pictures from all around",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="file to write (.glb)")
    parser.add_argument(
        "--as",
        dest="kind",
        choices=FORMS,
        default=FORMS[0],
        help="a textured mesh that other programs open, or Gaussians (default %(default)s)",
    )
    parser.add_argument(
        "--frames",
        type=whole(MIN_FRAMES, MAX_FRAMES),
        default=FRAMES,
        help="frames of a video that are used (default %(default)d)",
    )
    add_making(parser, "with --as splats: ")
    parser.add_argument("--anyway", action="store_true", help="use frames in which the check found faults")
    parser.add_argument("--json", action="store_true", help="print what was found and made as JSON")
    add_notes(parser)


def run(args: argparse.Namespace) -> int:
    """Make the mesh or the avatar."""
    began = time.perf_counter()
    check_name(args.out)
    with progress_bar() as show:
        options = options_of(args, show)
        if args.kind == "splats" and options.steps and not available():
            print(f"glsplat avatar video: {NUMBA_MISSING}", file=sys.stderr)
        try:
            made = from_video(
                *args.frames_from,
                options=options,
                form=args.kind,
                frames=args.frames,
                anyway=args.anyway,
                meta=notes_of(args),
            )
        except CaptureError as error:
            hint = "" if args.anyway else "; --anyway goes on all the same, where it can"
            raise CaptureError(f"{error}{hint}", error.findings) from None
    words = f"; {made.unseen:.0%} of the surface is guessed"
    write(made.content, args, began, _facts(made), words)
    if not args.json:
        for line in made.left_out:
            print(line)
        if made.problem:
            print(made.problem)
    return 0


def _facts(made: VideoResult) -> dict[str, Any]:
    """Return the command's own facts for --json."""
    return {
        "unseen": round(made.unseen, 4),
        "frames": [
            {"name": frame.name, "turn": round(frame.turn, 1), "overlap": round(view.overlap, 4)}
            for frame, view in zip(made.frames, made.fit.views, strict=True)
        ],
        "left_out": list(made.left_out),
        "stature": round(float(made.fit.stature), 4),
        "problem": made.problem,
    }
