"""``glsplat bench``: what a frame costs on this driver, stage by stage, and what batching the eyes saves."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from tqdm import tqdm

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.evaluate.machine import machine
from glsplat.formats.scene_file import SceneFile
from glsplat.gl.context import Context, create_context
from glsplat.meshes import RiggedMesh
from glsplat.renderer import Renderer
from glsplat.scene import Content, Shown
from glsplat.skinning.pose import Pose
from glsplat.views import splats_of, view_of, viewing_point

from .args import add_scene, motion_of, open_scene, single, size
from .usage import UsageError

HELP = (
    "Measure stage times (median and 95th percentile after warm-up), the draw floor, the gain of drawing both eyes in "
    "one pass, bytes a splat, and what skinning costs. Timings of one run are comparable; machines are not."
)
EXAMPLE = "glsplat bench --sizes 512x512 1024x1024 --frames 30 --json > bench.json"

FOV = 65.0
WARM_UP = 5
STAGES = ("pose", "frame", "skin", "key", "sort", "project", "draw", "resolve", "read")


@dataclass(frozen=True)
class Series:
    """Milliseconds of one thing, many times."""

    median: float
    p95: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Series:
        """Statistics of the samples."""
        return cls(round(float(np.median(values)), 3), round(float(np.percentile(values, 95)), 3))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    add_scene(parser)
    parser.add_argument("--sizes", type=size, nargs="+", default=[(512, 512), (1024, 1024)], help="pixels an eye")
    parser.add_argument("--views", type=int, nargs="+", choices=(1, 2), default=[2], help="eyes (default 2)")
    parser.add_argument("--frames", type=int, default=30, help="measured frames a setting (default 30)")
    parser.add_argument("--motion", default="wave-and-turn", help="motion of an avatar (default wave-and-turn)")
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
    context = create_context(args.device)
    try:
        bench = Bench(context, args)
        settings = [
            (s, pixels, views) for s in bench.kinds(scene, file) for pixels in args.sizes for views in args.views
        ]
        progress = tqdm(total=len(settings) + 1, unit="setting", disable=args.json or not sys.stderr.isatty())
        rows = []
        for (kind, model, poses), pixels, views in settings:
            progress.set_description(f"{kind} {views} x {pixels[0]}x{pixels[1]}")
            rows.append(bench.setting(kind, model, poses, pixels, views, file.pose_at if model is file.scene else None))
            progress.update()
        skins = bench.influences(scene) if isinstance(scene, Avatar) and not args.static else []
        progress.update()
        progress.close()
        result = {**machine(), "driver": context.driver, "backend": context.backend, "frames": args.frames}
        result |= {"settings": rows, "influences": skins}
        print(json.dumps(result) if args.json else table(result))
    finally:
        context.release()
    return 0


class Bench:
    """Measurements on one context; everything compared is interleaved frame by frame."""

    def __init__(self, context: Context, args: argparse.Namespace) -> None:
        self._context, self._args = context, args
        self._config = RenderConfig(target=args.float_target, sorter=args.sorter)

    def kinds(self, scene: Content | None, file: SceneFile) -> list[tuple[str, Shown, list[Pose | None]]]:
        """(name, scene, poses): static, and for avatars in motion as well; a scene of several things as it plays."""
        frames = self._args.frames + WARM_UP
        if scene is None or isinstance(scene, RiggedMesh):
            return [("in motion" if file.motions else "static", file.scene, [None] * frames)]
        out: list[tuple[str, Shown, list[Pose | None]]] = [("static", splats_of(scene), [None] * frames)]
        if isinstance(scene, Avatar) and not self._args.static:
            motion = motion_of(self._args.motion, scene.skeleton)
            out.append(("in motion", scene, [motion.at(i / 30) for i in range(frames)]))
        return out

    def setting(
        self,
        kind: str,
        scene: Shown,
        poses: list[Pose | None],
        pixels: tuple[int, int],
        views: int,
        pose_at: Callable[[float], None] | None = None,  # plays the motions of the scene, in seconds
    ) -> dict[str, Any]:
        """Whole frame, draw floor, stages, and the pair (or the one view) against single renders."""
        pair, single, staged = (
            self._renderer(scene, pixels, n, timed) for n, timed in ((views, 0), (1, 0), (views, 1))
        )
        whole, floor, gpu, apart, still, still_apart = [], [], [], [], [], []
        query = self._context.ctx.query(time=True)
        stages: dict[str, list[float]] = {}
        for i, pose in enumerate(poses):
            eyes = self._eyes(scene, pixels, i)[:views]
            if pose_at is not None:
                pose_at(i / 30)
            pair.render(eyes, pose)
            total = pair.timings["total"]
            with query:
                lowest = pair.redraw(eyes)
            two = 0.0
            for eye in eyes:
                single.render([eye], pose)
                two += single.timings["total"]
            staged.render(eyes, pose)
            # once more with nothing moved: no skinning, no sorting
            pair.render(eyes, pose)
            unmoved, unmoved_apart = pair.timings["total"], self._unmoved(single, eyes, pose)
            if i < WARM_UP:
                continue
            whole.append(total)
            floor.append(lowest)
            gpu.append(query.elapsed / 1e6)
            apart.append(two)
            still.append(unmoved)
            still_apart.append(unmoved_apart)
            for stage in STAGES:
                stages.setdefault(stage, []).append(staged.timings.get(stage, 0.0))
        stats, memory = pair.stats, pair.nbytes()
        count = stats.splats
        row = {
            "kind": kind,
            "size": list(pixels),
            "views": views,
            "splats": count,
            "drawn": stats.drawn,
            "variant": asdict(pair.variant),
            "float_target": pair.target_dtype,
            "frame_ms": asdict(Series.of(whole)),
            "floor_ms": asdict(Series.of(floor)),
            "gpu_draw_ms": asdict(Series.of(gpu)),  # the driver's own timer around the same draw
            "frame_to_floor": round(float(np.median(np.array(whole) / floor)), 3),
            "single_renders_ms": asdict(Series.of(apart)),
            "batching_gain": round(float(np.median(np.array(apart) / whole)), 3),
            "unmoved_ms": asdict(Series.of(still)),
            "unmoved_batching_gain": round(float(np.median(np.array(still_apart) / still)), 3),
            "stages_ms": {stage: asdict(Series.of(values)) for stage, values in stages.items() if max(values) > 0},
            "splats_per_second": round(count * 1000 / float(np.median(whole))),
            "bytes_per_splat": round((memory["splats"] + memory["sh"] + memory["work"]) / max(count, 1), 1),
            "programs": pair.programs_compiled,
        }
        for renderer in (pair, single, staged):
            renderer.release()
        return row

    def influences(self, avatar: Avatar) -> list[dict[str, Any]]:
        """The skin stage by joints a splat, interleaved, and the pose upload it needs."""
        motion = motion_of(self._args.motion, avatar.skeleton)
        counts = [k for k in (1, 2, 4, 8) if k <= avatar.skin.influences]
        pixels = self._args.sizes[0]
        config = self._config
        renderers = {
            k: Renderer(
                avatar,
                size=pixels,
                views=2,
                context=self._context,
                timed=True,
                config=RenderConfig(target=config.target, sorter=config.sorter, influences=k),  # type: ignore[arg-type]
            )
            for k in counts
        }
        samples: dict[int, list[tuple[float, float]]] = {k: [] for k in counts}
        for i in range(self._args.frames + WARM_UP):
            for k, renderer in renderers.items():
                renderer.render(self._eyes(avatar, pixels, i), motion.at(i / 30))
                if i >= WARM_UP:
                    samples[k].append((renderer.timings["skin"], renderer.timings["pose"]))
        for renderer in renderers.values():
            renderer.release()
        return [
            {
                "influences": k,
                "skin_ms": asdict(Series.of([skin for skin, _ in samples[k]])),
                "pose_and_upload_ms": asdict(Series.of([pose for _, pose in samples[k]])),
            }
            for k in counts
        ]

    def _unmoved(self, renderer: Renderer, eyes: Sequence[Camera], pose: Pose | None) -> float:
        """Two single renders of an unmoved scene: each eye is drawn twice and its second time counts."""
        total = 0.0
        for eye in eyes:
            renderer.render([eye], pose)
            renderer.render([eye], pose)
            total += renderer.timings["total"]
        return total

    def _renderer(self, scene: Shown, pixels: tuple[int, int], views: int, timed: int) -> Renderer:
        return Renderer(scene, size=pixels, views=views, config=self._config, context=self._context, timed=bool(timed))

    def _eyes(self, scene: Shown, pixels: tuple[int, int], frame: int) -> list[Camera]:
        """The pair of a head that orbits one degree a frame."""
        eye, target = viewing_point(scene, FOV)
        x, y, z = eye - target
        angle = np.radians(frame)
        turned = np.array([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)])
        return view_of(target + turned, target, pixels, FOV, ipd=0.055)


def table(result: dict[str, Any]) -> str:
    """The numbers as text."""
    lines = [
        f"{result['driver']} ({result['backend']}); {result['machine']}, {result['cores']} cores; {result['date']}"
    ]
    for row in result["settings"]:
        width, height = row["size"]
        lines += [
            "",
            f"{row['kind']}, {row['views']} x {width}x{height}: {row['splats']} splats, {row['drawn']} drawn, "
            f"{row['bytes_per_splat']} bytes a splat on the GPU, target {row['float_target']}",
            f"  {'whole frame':22}{row['frame_ms']['median']:9.2f} ms   p95 {row['frame_ms']['p95']:9.2f}"
            f"   {row['splats_per_second']:,} splats/s",
            f"  {'draw floor':22}{row['floor_ms']['median']:9.2f} ms   p95 {row['floor_ms']['p95']:9.2f}"
            f"   frame / floor {row['frame_to_floor']:.3f}, GPU timer {row['gpu_draw_ms']['median']:.2f}",
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
