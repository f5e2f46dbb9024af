"""``glsplat bench``: measure the stages of a frame on this driver, and the gain of drawing both eyes in one pass."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from typing import Any

from glsplat.config import RenderConfig
from glsplat.extras.evaluate.frames import WARM_UP, Bench, Quiet, until_quiet
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import create_context
from glsplat.io.provenance import machine
from glsplat.meshes import RiggedMesh
from glsplat.motion.motion import Motion
from glsplat.scene import Content, SceneLike, is_rigged
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.pose import Pose

from .args import add_detail, add_driver, add_scene, detail_of, motion_of, open_scene, single, size, whole
from .progress import Progress
from .usage import UsageError

HELP = (
    "Measure stage times (median and 95th percentile after warm-up), the draw floor, the gain of drawing both eyes in "
    "one pass, bytes per splat, and the cost of skinning. Timings of one run are comparable; machines are not."
)
_MOTION = "wave-and-turn"
EXAMPLE = "glsplat bench --sizes 512x512 1024x1024 --frames 30 --json > bench.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    add_scene(parser)
    parser.add_argument("--sizes", type=size, nargs="+", default=[(512, 512), (1024, 1024)], help="pixels per eye")
    parser.add_argument("--views", type=int, nargs="+", choices=(1, 2), default=[2], help="eyes (default 2)")
    parser.add_argument("--frames", type=whole(3), default=30, help="measured frames per setting (default 30)")
    parser.add_argument("--motion", help=f"motion of an avatar (default {_MOTION}, if it can be driven)")
    parser.add_argument("--static", action="store_true", help="measure an avatar in its zero pose only")
    add_detail(parser, lean=False)
    add_driver(parser)
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print the results."""
    file = open_scene(args)
    scene = single(file)
    motion = _motion(args, scene)
    context = create_context(args.device)
    try:
        config = RenderConfig(target=args.float_target, sorter=args.sorter, **detail_of(args))

        def measured(frames: int) -> tuple[dict[str, Any], float]:
            rows: list[dict[str, Any]] = []
            bench = Bench(context, frames, config)
            kinds = kinds_of(bench, scene, motion, file, frames + WARM_UP)
            settings = [(kind, pixels, views) for kind in kinds for pixels in args.sizes for views in args.views]
            with Progress(len(settings), quiet=args.json) as progress:
                for (kind, model, poses), pixels, views in settings:
                    progress.show(len(rows), f"{kind} {views} x {pixels[0]}x{pixels[1]}")
                    pose_at = file.pose_at if model is file.scene else None
                    rows.append(bench.setting(kind, model, poses, pixels, views, pose_at))
            return {"frames": frames, "settings": rows}, max(row["noise"] for row in rows)

        found, quiet = until_quiet(measured, args.frames, lambda text: print(f"glsplat bench: {text}", file=sys.stderr))
        result = {**machine(), "driver": context.driver, "backend": context.backend, "quiet": asdict(quiet), **found}
        print(json.dumps(result) if args.json else table(result))
    finally:
        context.release()
    return 0


def _motion(args: argparse.Namespace, scene: Content | None) -> Motion | None:
    """Return the motion of the scene; None if it stands still. Prints a notice if the motion does not fit."""
    name = args.scene or "the default avatar"
    if args.static:
        return None
    if scene is None or not is_rigged(scene):
        if args.motion:
            raise UsageError(f"--motion is for one avatar that stands where its file puts it; {name} is none")
        return None
    why = why_not_driven(scene.skeleton)
    if args.motion or not why:
        return motion_of(args.motion or _MOTION, scene.skeleton)
    print(f"glsplat bench: {name}: {_MOTION} cannot drive this avatar: {why}; measured standing still", file=sys.stderr)
    return None


def kinds_of(
    bench: Bench, scene: Content | None, motion: Motion | None, file: SceneFile, frames: int
) -> list[tuple[str, SceneLike, list[Pose | None]]]:
    """Return (name, scene, poses) of each measurement: of single content, or of a scene as it plays."""
    if scene is None or (isinstance(scene, RiggedMesh) and not is_rigged(scene)):
        return [("in motion" if file.motions else "static", file.scene, [None] * frames)]
    return [*bench.kinds(scene, motion)]


def _content(row: dict[str, Any]) -> str:
    splats = f"{row['splats']} splats, {row['drawn']} drawn, {row['bytes_per_splat']} bytes a splat on the GPU"
    triangles = f"{row['triangles']} triangles, {row['mesh_bytes'] / 1e6:.1f} MB of meshes on the GPU"
    return ", ".join(([splats] if row["splats"] or not row["triangles"] else []) + [triangles] * bool(row["triangles"]))


def _floor(row: dict[str, Any]) -> str:
    return (
        f"  {'draw floor':22}{row['floor_ms']['median']:9.2f} ms   p95 {row['floor_ms']['p95']:9.2f}"
        f"   frame / floor {row['frame_to_floor']:.3f}, GPU timer {row['gpu_draw_ms']['median']:.2f}"
    )


def table(result: dict[str, Any]) -> str:
    """Return the numbers as text."""
    lines = [
        f"{result['driver']} ({result['backend']}); {result['machine']}, {result['cores']} cores; {result['date']}",
        Quiet(**result["quiet"]).words,
    ]
    for row in result["settings"]:
        width, height = row["size"]
        lines += [
            "",
            f"{row['kind']}, {row['views']} x {width}x{height}: {_content(row)}, target {row['float_target']}",
            f"  {'whole frame':22}{row['frame_ms']['median']:9.2f} ms   p95 {row['frame_ms']['p95']:9.2f}"
            f"   CPU {row['frame_ms']['cpu']:.2f}"
            + (f"   {row['splats_per_second']:,} splats/s" if row["splats"] else ""),
            *([_floor(row)] if row["splats"] else []),
            f"  {'nothing moved':22}{row['unmoved_ms']['median']:9.2f} ms   p95 {row['unmoved_ms']['p95']:9.2f}",
        ]
        if row["views"] > 1:
            gain, still = row["batching_gain"], row["unmoved_batching_gain"]
            lines.append(
                f"  {'two single renders':22}{row['single_renders_ms']['median']:9.2f} ms   p95 "
                f"{row['single_renders_ms']['p95']:9.2f}   batching gain {gain:.2f}x, {still:.2f}x with nothing moved"
            )
        for stage, values in row["stages_ms"].items():
            lines.append(f"    {stage:20}{values['median']:9.2f} ms   p95 {values['p95']:9.2f}")
    return "\n".join(lines)
