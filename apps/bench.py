"""``glsplat bench``: what a frame costs on this driver, stage by stage, and what batching the eyes saves."""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from tqdm import tqdm

from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.evaluate.frames import WARM_UP, Bench
from glsplat.evaluate.machine import machine
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import create_context
from glsplat.meshes import RiggedMesh
from glsplat.motion.motion import Motion
from glsplat.scene import Content, Shown, is_figure
from glsplat.skinning.pose import Pose
from glsplat.skinning.rigs.driven import why_not_driven

from .args import add_scene, motion_of, open_scene, single, size
from .usage import UsageError

HELP = (
    "Measure stage times (median and 95th percentile after warm-up), the draw floor, the gain of drawing both eyes in "
    "one pass, bytes a splat, and what skinning costs. Timings of one run are comparable; machines are not."
)
_MOTION = "wave-and-turn"
EXAMPLE = "glsplat bench --sizes 512x512 1024x1024 --frames 30 --json > bench.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    add_scene(parser)
    parser.add_argument("--sizes", type=size, nargs="+", default=[(512, 512), (1024, 1024)], help="pixels an eye")
    parser.add_argument("--views", type=int, nargs="+", choices=(1, 2), default=[2], help="eyes (default 2)")
    parser.add_argument("--frames", type=int, default=30, help="measured frames a setting (default 30)")
    parser.add_argument("--motion", help=f"motion of an avatar (default {_MOTION}, if it can be driven)")
    parser.add_argument("--static", action="store_true", help="measure an avatar in its zero pose only")
    parser.add_argument(
        "--float-target", choices=("auto", "8", "16f", "32f"), default="auto", help="accumulation format"
    )
    parser.add_argument("--sorter", choices=("auto", "cpu", "gpu"), default="auto", help="where splats are sorted")
    parser.add_argument("--device", help="EGL device: index or part of its name (also GLSPLAT_DEVICE)")
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.frames < 3:
        raise UsageError(f"--frames needs at least 3, not {args.frames}")
    file = open_scene(args)
    scene = single(file)
    motion = _motion(args, scene)
    context = create_context(args.device)
    try:
        bench = Bench(context, args.frames, RenderConfig(target=args.float_target, sorter=args.sorter))
        kinds = kinds_of(bench, scene, motion, file, args.frames + WARM_UP)
        settings = [(kind, pixels, views) for kind in kinds for pixels in args.sizes for views in args.views]
        progress = tqdm(total=len(settings) + 1, unit="setting", disable=args.json or not sys.stderr.isatty())
        rows = []
        for (kind, model, poses), pixels, views in settings:
            progress.set_description(f"{kind} {views} x {pixels[0]}x{pixels[1]}")
            rows.append(bench.setting(kind, model, poses, pixels, views, file.pose_at if model is file.scene else None))
            progress.update()
        skins = bench.influences(scene, motion, args.sizes[0]) if isinstance(scene, Avatar) and motion else []
        progress.update()
        progress.close()
        result = {**machine(), "driver": context.driver, "backend": context.backend, "frames": args.frames}
        result |= {"settings": rows, "influences": skins}
        print(json.dumps(result) if args.json else table(result))
    finally:
        context.release()
    return 0


def _motion(args: argparse.Namespace, scene: Content | None) -> Motion | None:
    """What moves it; None of what stands still, which is said where somebody could expect otherwise."""
    name = args.scene or "the default avatar"
    if args.static:
        return None
    if scene is None or not is_figure(scene):
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
) -> list[tuple[str, Shown, list[Pose | None]]]:
    """(name, scene, poses) of what is measured: one thing as ever, a scene of several as it plays."""
    if scene is None or (isinstance(scene, RiggedMesh) and not is_figure(scene)):
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
    """The numbers as text."""
    lines = [
        f"{result['driver']} ({result['backend']}); {result['machine']}, {result['cores']} cores; {result['date']}"
    ]
    for row in result["settings"]:
        width, height = row["size"]
        lines += [
            "",
            f"{row['kind']}, {row['views']} x {width}x{height}: {_content(row)}, target {row['float_target']}",
            f"  {'whole frame':22}{row['frame_ms']['median']:9.2f} ms   p95 {row['frame_ms']['p95']:9.2f}"
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
    for row in result["influences"]:
        lines += [] if row is not result["influences"][0] else ["", "skinning by joints a splat:"]
        lines.append(
            f"    {row['influences']:<20}{row['skin_ms']['median']:9.2f} ms   p95 {row['skin_ms']['p95']:9.2f}"
            f"   pose and upload {row['pose_and_upload_ms']['median']:.2f} ms"
        )
    return "\n".join(lines)
