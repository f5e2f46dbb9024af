"""``glsplat report``: error against run time, what batching gains, what is left out, and whether hard cases hold."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tqdm import tqdm

from glsplat.avatar import Avatar, default_avatar
from glsplat.camera import load_cameras
from glsplat.context import Context, create_context
from glsplat.errors import FormatError, GlsplatError
from glsplat.formats.files import replace_file

from .bench import WARM_UP
from .machine import machine
from .report_batching import batching
from .report_error import require_extra
from .report_html import page
from .report_knobs import Subject, base_config, measure, settings_of, steps
from .report_left_out import features_of, left_out, unmoved
from .report_stability import frame_cases, judge
from .report_stability_skin import skin_cases
from .scene import load_scene, splats_of

HELP = (
    "Render scenes over a grid of settings, compare with a float64 reference, time every setting in one process, and "
    "write report.html (opens offline), plots and report.json. The default avatar is always among the scenes."
)
EXAMPLE = "glsplat report --quick -o out/report"

BATCHING_SIZES = (512, 768, 1024)
NOT_MEASURED = {
    "re-sort period under motion": "the renderer sorts whenever something moved; an old sort_viewmat changes the order "
    "but saves no sort, so a time beside that error would not be a price",
    "splat count": "scenes come without levels of detail",
    "views = 1 with layer code": "a program for two views cannot draw one",
    "latency": "glsplat demo and glsplat replay measure it",
}
_BATCHING_STEPS = 12  # a frame of a batching row is seven renders of larger pictures


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument(
        "scenes",
        nargs="*",
        metavar="SCENE",
        help="PLY, .splat or glTF besides the default avatar; NAME.camera.json beside NAME.ply is its view",
    )
    parser.add_argument("--quick", action="store_true", help="fewer frames, smaller pictures")
    parser.add_argument("--frames", type=int, help="measured frames a setting (default 30; 15 with --quick)")
    parser.add_argument("--size", type=int, help="pixels a side of section 1 (default 256; 128 with --quick)")
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE)")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/report"), help="folder (default out/report)")


def run(args: argparse.Namespace) -> int:
    """Measure, write, and say what does not hold: 1 if a stability case failed."""
    frames = (15 if args.quick else 30) if args.frames is None else args.frames
    size = (128 if args.quick else 256) if args.size is None else args.size
    if not 3 <= frames <= 10000:
        raise GlsplatError(f"--frames needs 3 to 10000, not {frames}")
    if not 16 <= size <= 1024:
        raise GlsplatError(f"--size needs 16 to 1024 (the float64 reference is slow), not {size}")
    require_extra()
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FormatError(f"{args.output}: cannot make the folder ({error.strerror})") from None
    subjects = [s for path in (None, *args.scenes) for s in subjects_of(path, size)]
    context = create_context(args.device)
    try:
        result = measured(context, subjects, frames, args.quick, BATCHING_SIZES)
    finally:
        context.release()
    files = write(result, args.output)
    failed = [row for row in result["stability"] if row["verdict"] != "holds"]
    print(f"{len(result['stability']) - len(failed)} of {len(result['stability'])} stability cases hold")
    for row in failed:
        print(f"  failed: {row['group']}, {row['case']}: {row['seen']}")
    print(*files, sep="\n")
    return 1 if failed else 0


def subjects_of(path: str | None, size: int) -> list[Subject]:
    """The ways a scene is looked at: static, and an avatar in motion as well. None is the default avatar."""
    scene = default_avatar() if path is None else load_scene(argparse.Namespace(scene=path))
    name = "default avatar" if path is None else Path(path).name
    cameras = Path(path).with_suffix(".camera.json") if path is not None else None
    if cameras is not None and cameras.exists():
        views = load_cameras(cameras)
        scale = min(1.0, size / max(views[0].width, views[0].height))
        views = [v.resized(max(1, round(v.width * scale)), max(1, round(v.height * scale))) for v in views]
        return [Subject(name, scene, size, cameras=tuple(views))]
    if isinstance(scene, Avatar):
        return [Subject(f"{name}, static", scene.splats, size), Subject(f"{name}, in motion", scene, size, moving=True)]
    return [Subject(name, scene, size)]


def measured(
    context: Context, subjects: list[Subject], frames: int, quick: bool, sizes: tuple[int, ...] = BATCHING_SIZES
) -> dict[str, Any]:
    """All sections of the report as one JSON object; plots are not made yet."""
    base, cases = base_config(context), [*frame_cases(), *skin_cases()]
    grids = [settings_of(subject, base) for subject in subjects]
    main = next((s for s in subjects if s.moving), subjects[0])
    features = features_of(main.scene, context)
    fewer = max(3, frames // 3) if quick else frames
    middle = WARM_UP + frames // 2
    error_frames = [middle] if quick else [WARM_UP, middle, WARM_UP + frames - 1]
    total = sum(steps(grid, frames) for grid in grids) + len(cases)
    total += (len(features) + 1) * (WARM_UP + fewer) + _BATCHING_STEPS * len(sizes) * (WARM_UP + fewer)
    with tqdm(total=total, unit="step", disable=not sys.stderr.isatty()) as bar:
        bar.set_description("stability")
        stability = judge(cases, context, bar.update)
        scenes = []
        for subject, grid in zip(subjects, grids, strict=True):
            bar.set_description(subject.name)
            scenes.append(measure(context, subject, grid, frames, error_frames, tick=bar.update))
        bar.set_description("what is left out")
        still = replace(main, moving=False, cameras=())
        rows = left_out(context, still, features, fewer, bar.update)
        unmoved_row = unmoved(context, replace(main, cameras=()), fewer, bar.update)
        batches = []
        for size in sizes:
            bar.set_description(f"batching {size}x{size}")
            both = replace(main, size=size, cameras=())
            batches.append(batching(context, both, fewer, lambda n: bar.update(_BATCHING_STEPS * n)))
    facts = machine()
    facts["versions"] |= {name: version(name) for name in ("matplotlib", "flip-evaluator", "simplejpeg")}
    return {
        **facts,
        "driver": context.driver,
        "backend": context.backend,
        "quick": quick,
        "frames": frames,
        "frames_of_the_rest": fewer,  # batching and what is left out
        "warm_up": WARM_UP,
        "scenes": scenes,
        "batching": batches,
        "batching_scene": main.name,
        "left_out": rows,
        "left_out_splats": len(splats_of(main.scene)),
        "unmoved": unmoved_row,
        "stability": stability,
        "not_measured": NOT_MEASURED,
    }


def write(result: dict[str, Any], folder: Path) -> list[Path]:
    """Plots, report.json and report.html, each complete or as it was; returns their paths, the page last."""
    from .report_plots import batching_plot, error_plot, knob_plot, left_out_plot

    pictures: dict[str, bytes] = {"batching.png": batching_plot(result["batching"])}
    pictures["left_out.png"] = left_out_plot(result["left_out"])
    for index, scene in enumerate(result["scenes"]):
        stem = f"{index}-" + (re.sub(r"[^a-z0-9]+", "-", scene["scene"].lower()).strip("-") or "scene")
        scene["plots"] = [f"{stem}.png", f"{stem}-knobs.png"]
        pictures |= dict(zip(scene["plots"], (error_plot(scene), knob_plot(scene)), strict=True))
    result = finite(result)
    text = json.dumps(result, indent=1, allow_nan=False)
    files = {**pictures, "report.json": text.encode(), "report.html": page(result, pictures).encode()}
    for name, data in files.items():
        replace_file(folder / name, [data])
    return [folder / name for name in files]


def finite(value: Any) -> Any:
    """The same JSON value with None for what JSON cannot say (NaN, infinity)."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
