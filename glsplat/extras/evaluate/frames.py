"""Cost of a frame by stage, measured by renderers that take turns on one context, and the gate of measurements.

The gate is the load by other processes, and the difference of the default to itself.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from glsplat.avatar import Avatar
from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.meshes import RiggedMesh
from glsplat.motion.motion import Motion
from glsplat.renderer.probe import Probe
from glsplat.scene import Content, Scene, SceneLike, is_rigged
from glsplat.skinning.pose import Pose
from glsplat.views import orbited, view_of, viewing_point

T = TypeVar("T")

MAX_SHARE = 0.03
"""Largest share for valid times: of the cores used by others, and of the default's difference to itself."""

FOV = 65.0
WARM_UP = 5
STAGES = ("pose", "mesh", "frame", "skin", "key", "sort", "project", "draw", "resolve", "read")


@dataclass(frozen=True)
class Quiet:
    """How quiet the machine was during a measurement."""

    others: float | None  # share of all cores used by other processes and the host; None: not Linux
    noise: float | None = None  # relative difference of the default to itself; None: not measured

    @property
    def ok(self) -> bool:
        """Whether both shares are at most MAX_SHARE or unknown."""
        return all(share is None or share <= MAX_SHARE for share in (self.others, self.noise))

    @property
    def words(self) -> str:
        """Both shares in words."""
        parts = [] if self.others is None else [f"other processes used {self.others:.1%} of the cores"]
        parts += [] if self.noise is None else [f"the default differs from itself by {self.noise:.1%}"]
        return ", ".join(parts) or "not known here"


class Watch:
    """Measures the CPU time of other processes since its creation; children count as own once waited for."""

    def __init__(self) -> None:
        self._start = _seconds()

    def read(self, noise: float | None = None) -> Quiet:
        """Return how quiet the machine was since the creation."""
        end, noise = _seconds(), None if noise is None else round(noise, 4)
        if self._start is None or end is None:
            return Quiet(None, noise)
        total, busy, own = (after - before for after, before in zip(end, self._start, strict=True))
        return Quiet(round(max(0.0, busy - own) / max(total, 1e-9), 4), noise)


def until_quiet(
    measure: Callable[[int], tuple[T, float | None]], frames: int, say: Callable[[str], object] = print
) -> tuple[T, Quiet]:
    """Return (result, quiet) of ``measure(frames)``, which returns (result, noise).

    On a busy machine measure once more with twice the frames; ``say`` gets a line if it is still busy.
    """
    for count in (frames, 2 * frames):
        watch = Watch()
        result, noise = measure(count)
        quiet = watch.read(noise)
        if quiet.ok:
            break
    else:
        say(f"not a quiet machine: {quiet.words}; expected at most {MAX_SHARE:.0%}; compare CPU times, or end others")
    return result, quiet


def _seconds() -> tuple[float, float, float] | None:
    """Return seconds of all cores: (in all, busy, busy for this process and the children it waited for)."""
    try:
        line = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0]
    except OSError:
        return None
    times = [int(word) / os.sysconf("SC_CLK_TCK") for word in line.split()[1:9]]
    return sum(times), sum(times) - times[3] - times[4], sum(os.times()[:4])  # without idle and iowait


@dataclass(frozen=True)
class Series:
    """Statistics of repeated measurements in milliseconds."""

    median: float
    p95: float
    cpu: float | None = None  # median of the process with all its threads; None: not measured

    @classmethod
    def of(cls, values: Sequence[float], cpu: Sequence[float] = ()) -> Series:
        """Return statistics of samples in ms."""
        median, p95 = float(np.median(values)), float(np.percentile(values, 95))
        return cls(round(median, 3), round(p95, 3), round(float(np.median(cpu)), 3) if len(cpu) else None)

    @classmethod
    def of_times(cls, times: Sequence[tuple[float, float]]) -> Series:
        """Return statistics of times by ``timed``."""
        return cls.of([wall for wall, _ in times], [cpu for _, cpu in times])


def timed(call: Callable[[], Any]) -> tuple[tuple[float, float], Any]:
    """Return ((ms, ms of CPU of this process with all threads), result)."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = call()
    return ((time.perf_counter() - wall) * 1e3, (time.process_time() - cpu) * 1e3), result


def halves_apart(values: Sequence[float]) -> float:
    """Return the relative difference between the medians of even and odd samples: the noise of the series."""
    return round(abs(float(np.median(values[::2]) / np.median(values[1::2])) - 1), 4)


def triangles_of(scene: SceneLike) -> int:
    """Return the number of triangles of visible meshes."""
    items = (item for item in Scene.of(scene) if item.visible)
    return sum(len(item.content.faces) for item in items if isinstance(item.content, RiggedMesh))


class Bench:
    """Measurements on one context; everything compared is interleaved frame by frame."""

    def __init__(self, context: Context, frames: int, config: RenderConfig | None = None) -> None:
        self._context, self._frames = context, frames
        self._config = config or RenderConfig()

    def kinds(self, scene: Content, motion: Motion | None) -> list[tuple[str, Content, list[Pose | None]]]:
        """Return (name, scene, poses) of the static scene and, for an avatar, of it in ``motion``."""
        frames = self._frames + WARM_UP
        still = scene.splats if isinstance(scene, Avatar) else scene
        out: list[tuple[str, Content, list[Pose | None]]] = [("static", still, [None] * frames)]
        if is_rigged(scene) and motion is not None:
            out.append(("in motion", scene, [motion.at(i / 30) for i in range(frames)]))
        return out

    def setting(
        self,
        kind: str,
        scene: SceneLike,
        poses: list[Pose | None],
        pixels: tuple[int, int],
        views: int,
        pose_at: Callable[[float], None] | None = None,  # plays the motions of the scene, in seconds
    ) -> dict[str, Any]:
        """Return times of whole frames, of the draw alone, of stages, and of one render per view, as JSON values."""
        pair, single, staged = (
            Probe(scene, size=pixels, views=n, config=self._config, context=self._context, timed=timed)
            for n, timed in ((views, False), (1, False), (views, True))
        )
        whole, cpu, floor, gpu, apart, still, still_apart = [], [], [], [], [], [], []
        with self._context.entered("Bench"):
            query = self._context.ctx.query(time=True)
        stages: dict[str, list[float]] = {}
        for i, pose in enumerate(poses):
            start, target = viewing_point(scene, FOV)  # the head orbits by a degree a frame
            eyes = view_of(orbited(start, target, np.radians(i)), target, pixels, FOV, ipd=0.055)[:views]
            if pose_at is not None:
                pose_at(i / 30)
            total, _ = timed(lambda: pair.render(eyes, pose))  # noqa: B023 - called at once
            with self._context, query:
                lowest = pair.redraw(eyes)
            two = 0.0
            for eye in eyes:
                single.render([eye], pose)
                two += single.timings["total"]
            staged.render(eyes, pose)
            # render an unmoved frame: no skinning, no sorting; of each eye the second one
            pair.render(eyes, pose)
            unmoved, unmoved_apart = pair.timings["total"], 0.0
            for eye in eyes:
                single.render([eye], pose)
                single.render([eye], pose)
                unmoved_apart += single.timings["total"]
            if i < WARM_UP:
                continue
            whole.append(total[0])
            cpu.append(total[1])
            floor.append(lowest)
            with self._context.entered("Bench"):
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
            "triangles": triangles_of(scene),
            "mesh_bytes": memory["meshes"],
            "variant": asdict(pair.variant),
            "float_target": pair.target_dtype,
            "frame_ms": asdict(Series.of(whole, cpu)),
            "noise": halves_apart(whole),
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
