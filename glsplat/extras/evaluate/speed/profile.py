"""Profile: CPU and GPU time a stage. On software rasterizers the GPU's work is done by the same cores, and deferred."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

import moderngl
import numpy as np

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.extras.evaluate.frames import STAGES, WARM_UP
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import SceneLike
from glsplat.skinning.pose import Pose
from glsplat.timing import StageTimer

__all__ = ["GpuTimer", "profile"]


class GpuTimer(StageTimer):
    """Also asks the driver how long each stage took (GL_TIME_ELAPSED); ``gpu_ms`` has it once ``collect()`` waited."""

    def __init__(self, ctx: moderngl.Context) -> None:
        super().__init__()
        self._ctx = ctx
        self._queries: list[Any] = []
        self._stages: list[str] = []
        self._asking: Any = None  # the query that is running
        self.gpu_ms: dict[str, float] = {}

    def start(self) -> None:
        """Begin a frame."""
        super().start()
        self._stages = []
        self._begin()

    def mark(self, stage: str) -> None:
        """End a stage."""
        self._end()
        self._stages.append(stage)
        super().mark(stage)
        self._begin()

    def stop(self) -> None:
        """End the frame."""
        self._end()
        super().stop()

    def collect(self) -> None:
        """Wait for the answers, after the frame."""
        self.gpu_ms = {}
        for stage, query in zip(self._stages, self._queries, strict=False):
            self.gpu_ms[stage] = self.gpu_ms.get(stage, 0.0) + query.elapsed / 1e6

    def _begin(self) -> None:
        if len(self._stages) == len(self._queries):
            self._queries.append(self._ctx.query(time=True))
        self._asking = self._queries[len(self._stages)]
        self._asking.__enter__()

    def _end(self) -> None:
        asking, self._asking = self._asking, None
        if asking is not None:
            asking.__exit__(None, None, None)

    def abandon(self) -> None:
        """End what a frame that failed left running: the context can ask one question at a time."""
        self._end()


def profile(
    context: Context,
    scene: SceneLike,
    views: Sequence[Sequence[Camera]],
    poses: Sequence[Pose | None],
    config: RenderConfig,
) -> dict[str, Any]:
    """Medians over frames: of each stage the CPU's time to issue it, the driver's for it, and both when each is waited
    for; ``frame_ms`` of the whole, which is less than the sum where stages overlap.

    ``views`` and ``poses`` are those of each frame, of one size; the first ones (``WARM_UP``) do not count.
    """
    size = views[0][0].width, views[0][0].height
    rows: dict[str, dict[str, list[float]]] = {kind: {} for kind in ("cpu", "gpu", "waited")}
    whole: list[float] = []
    with ExitStack() as stack:

        def renderer(timed: bool) -> Renderer:
            made = Renderer(scene, size=size, views=len(views[0]), config=config, context=context, timed=timed)
            stack.callback(made.release)
            return made

        plain, asked, waited = renderer(False), renderer(False), renderer(True)
        timer = GpuTimer(context.ctx)
        asked.timer = timer

        def abandon() -> None:
            with context.entered("profile"):
                timer.abandon()

        stack.callback(abandon)
        for i, (cameras, pose) in enumerate(zip(views, poses, strict=True)):
            plain.render(cameras, pose)
            asked.render(cameras, pose)
            waited.render(cameras, pose)
            with context.entered("profile"):
                timer.collect()
            if i < WARM_UP:
                continue
            whole.append(plain.timings["total"])
            for kind, times in (("cpu", timer.ms), ("gpu", timer.gpu_ms), ("waited", waited.timings)):
                for stage in STAGES:
                    if stage in times:
                        rows[kind].setdefault(stage, []).append(times[stage])
    stages = [stage for stage in STAGES if any(stage in times for times in rows.values())]
    medians = {
        stage: {kind: round(float(np.median(times.get(stage, [0.0]))), 3) for kind, times in rows.items()}
        for stage in stages
    }
    return {
        "size": list(size),
        "views": len(views[0]),
        "frame_ms": round(float(np.median(whole)), 3),
        "stages": medians,
    }
