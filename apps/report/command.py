"""``glsplat report``: error against run time, cost of unused features, stability in hard cases."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from glsplat.avatar import Avatar, splats_of
from glsplat.extras.evaluate.costs import features_of, left_out, unmoved
from glsplat.extras.evaluate.frames import Watch
from glsplat.extras.evaluate.precision import lpips_if_there, measure
from glsplat.extras.evaluate.stability.extremes import all_cases
from glsplat.extras.evaluate.stability.frame import judge
from glsplat.extras.evaluate.subjects import PERSON_SPLATS, Subject, check_cameras, subjects_of
from glsplat.formats import suffixes
from glsplat.gl.context import Context, create_context
from glsplat.io.files import replace_file
from glsplat.io.provenance import machine
from glsplat.optional import require_package
from glsplat.skinning.driven import why_not_driven

from ..args import whole
from ..progress import Progress
from ..usage import make_folder
from .html import page

HELP = (
    "Render scenes by combinations of settings, compare with a float64 reference, time them in one process, write "
    "report.html (opens offline), plots and report.json, and end with the options to use. The default avatar is always "
    "among the scenes."
)
EXAMPLE = "glsplat report --quick -o out/report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        help=f"a {suffixes()} besides the default avatar (NAME.camera.json beside NAME.ply is its view), or a rigged "
        f"person (.npz), drawn as {PERSON_SPLATS} splats and compared with the same ones without a limit of joints",
    )
    parser.add_argument(
        "--cameras",
        nargs="+",
        default=[],
        metavar="WHERE",
        help="folders with NAME.camera.json for scenes without a camera file, or NAME=FILE for one scene",
    )
    parser.add_argument("--quick", action="store_true", help="fewer frames, smaller pictures")
    parser.add_argument("--frames", type=whole(3, 10000), help="measured frames of a setting (default 24; 8 if quick)")
    parser.add_argument(
        "--size", type=whole(16, 1024), help="picture side in pixels, section 1 (default 256; 128 with --quick)"
    )
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/report"), help="folder (default out/report)")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print failures; return 1 if a stability case failed."""
    frames = (8 if args.quick else 24) if args.frames is None else args.frames
    size = (128 if args.quick else 256) if args.size is None else args.size
    for package in ("flip_evaluator", "matplotlib"):
        require_package("the report", package, "report")
    check_cameras(args.cameras, args.scenes)
    paths = [None, *dict.fromkeys(args.scenes)]
    subjects = [s for path in paths for s in subjects_of(path, size, args.cameras)]
    for subject in subjects:
        if subject.moving and isinstance(subject.scene, Avatar) and (why := why_not_driven(subject.scene.skeleton)):
            print(f"glsplat report: {subject.name}: no motion can drive this avatar: {why}", file=sys.stderr)
    make_folder(args.output)
    context = create_context(args.device)
    try:
        result = measured(context, subjects, frames, args.quick)
    finally:
        context.release()
    files = write(result, args.output)
    failed = [row for row in result["stability"] if row["verdict"] != "holds"]
    print(f"{len(result['stability']) - len(failed)} of {len(result['stability'])} stability cases hold")
    for row in failed:
        print(f"  failed: {row['group']}, {row['case']}: {row['seen']}")
    print(*files, sep="\n")
    return 1 if failed else 0


def measured(context: Context, subjects: list[Subject], frames: int, quick: bool) -> dict[str, Any]:
    """Return all sections of the report as one JSON object, without plots."""
    watch, lpips = Watch(), lpips_if_there()
    main = next((s for s in subjects if s.moving), subjects[0])
    still = replace(main, cameras=())
    fewer = max(3, frames // 4) if quick else max(3, frames // 2)
    seconds: dict[str, float] = {}
    with Progress(len(subjects) + 2) as bar:

        @contextmanager
        def section(name: str, text: str = "") -> Iterator[None]:
            bar.show(bar.done, text or name)
            start = time.perf_counter()
            yield
            seconds[name] = round(seconds.get(name, 0.0) + time.perf_counter() - start, 1)
            bar.update()

        with section("stability"):
            stability = judge(all_cases(), context)
        scenes = []
        for subject in subjects:
            with section("scenes", subject.name):
                scenes.append(measure(context, subject, frames, lpips))
        with section("left out"):
            rows = left_out(context, replace(still, moving=False), features_of(main.scene, context), fewer)
            unmoved_row = unmoved(context, still, fewer)
    facts = machine()
    facts["versions"] |= {name: version(name) for name in ("matplotlib", "flip-evaluator", "simplejpeg")}
    return {
        **facts,
        "driver": context.driver,
        "backend": context.backend,
        "quick": quick,
        "frames": frames,
        "frames_left_out": fewer,
        "seconds": seconds,
        "scenes": scenes,
        "left_out": rows,
        "left_out_splats": len(splats_of(main.scene)),
        "unmoved": unmoved_row,
        "stability": stability,
        "quiet": asdict(watch.read(max(scene["quiet"]["noise"] for scene in scenes))),
    }


def write(result: dict[str, Any], folder: Path) -> list[Path]:
    """Write plots, report.json and report.html atomically; return their paths, the page last."""
    from .plots import left_out_plot, precision_plot

    pictures = {"left_out.png": left_out_plot(result["left_out"])}
    for index, scene in enumerate(result["scenes"]):
        stem = re.sub(r"[^a-z0-9]+", "-", scene["scene"].lower()).strip("-") or "scene"
        scene["plot"] = f"{index}-{stem}.png"
        pictures[scene["plot"]] = precision_plot([scene])
    result = finite(result)
    text = json.dumps(result, indent=1, allow_nan=False)
    files = {**pictures, "report.json": text.encode(), "report.html": page(result, pictures).encode()}
    for name, data in files.items():
        replace_file(folder / name, [data])
    return [folder / name for name in files]


def finite(value: Any) -> Any:
    """Return the JSON value with None for NaN and infinity."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
