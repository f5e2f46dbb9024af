"""Budget: which level of detail, with hidden splats or without, at which size, holds a frame time; and what it costs.

Everything is drawn in turn in one process, and compared with the finest level drawn exactly, at full size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.extras.evaluate.frames import WARM_UP
from glsplat.extras.evaluate.metrics.pixels import psnr
from glsplat.gl.context import Context
from glsplat.net.pace.ladder import SCALES
from glsplat.renderer import Renderer
from glsplat.scene import Scene, SceneLike
from glsplat.skinning.pose import Pose

__all__ = ["Choice", "choices", "search"]

_COMPARED = 5  # frames whose pictures are compared, spread over all


@dataclass(frozen=True, slots=True)
class Choice:
    """One way to draw."""

    level: int = 0
    culled: bool = False  # hidden splats are left out
    scale: float = 1.0  # of the picture's sides


def choices(scene: SceneLike) -> list[Choice]:
    """All levels with and without hidden splats at full size; of the coarsest, smaller pictures as well."""
    contents = [item.content for item in Scene.of(scene) if item.visible]
    levels = max((len(getattr(content, "levels", ())) for content in contents), default=0)
    splats = [getattr(content, "splats", content) for content in contents]
    cones = [False, True] if any(getattr(one, "cones", None) is not None for one in splats) else [False]
    out = [Choice(level, culled) for level in range(levels + 1) for culled in cones]
    return out + [Choice(levels, cones[-1], scale) for scale in SCALES[1:]]


def search(
    context: Context,
    scene: SceneLike,
    views: Sequence[Sequence[Camera]],
    poses: Sequence[Pose | None],
    milliseconds: float,
    config: RenderConfig | None = None,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Median time of each choice, and the worst PSNR of its pictures: over the whole, and over the thing's box.

    ``chosen`` is the one of those within ``milliseconds`` whose box is the closest; None if there is none.
    """
    config = config or RenderConfig()
    options = choices(scene)
    compared = {
        *np.linspace(WARM_UP, len(views) - 1, min(_COMPARED, len(views) - WARM_UP)).round().astype(int).tolist()
    }
    times: list[list[float]] = [[] for _ in options]
    worst = [(np.inf, np.inf)] * len(options)
    drawn = [0] * len(options)
    with ExitStack() as stack:

        def renderer(choice: Choice) -> Renderer:
            own = replace(config, level=choice.level, cull_hidden=choice.culled)
            made = Renderer(
                scene, size=_size(views[0][0], choice.scale), views=len(views[0]), config=own, context=context
            )
            stack.callback(made.release)
            return made

        renderers = [renderer(choice) for choice in options]
        for i, (cameras, pose) in enumerate(zip(views, poses, strict=True)):
            truth: NDArray[np.uint8] | None = None
            for k, one in enumerate(renderers):
                pictures = one.render([camera.resized(*one.size) for camera in cameras], pose)
                if i >= WARM_UP:
                    times[k].append(one.timings["total"])
                    drawn[k] = one.stats.drawn
                truth = pictures if truth is None else truth  # the first choice is the exact one
                if i in compared:
                    worst[k] = _worse(worst[k], pictures, truth)
            progress()
    rows = [
        asdict(choice)
        | {
            "ms": round(float(np.median(times[k])), 3),
            "drawn": drawn[k],
            "psnr": round(worst[k][0], 2),
            "psnr_box": round(worst[k][1], 2),
        }
        for k, choice in enumerate(options)
    ]
    within = [row for row in rows if row["ms"] <= milliseconds]
    best = max(within, key=lambda row: (row["psnr_box"], -row["ms"]), default=None)
    return {"budget_ms": milliseconds, "rows": rows, "chosen": best}


def _size(camera: Camera, scale: float) -> tuple[int, int]:
    return max(1, round(camera.width * scale)), max(1, round(camera.height * scale))


def _worse(before: tuple[float, float], pictures: NDArray[np.uint8], truth: NDArray[np.uint8]) -> tuple[float, float]:
    whole, box = before
    for picture, exact in zip(pictures, truth, strict=True):
        height, width = exact.shape[:2]
        if picture.shape != exact.shape:
            picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR)
        a, b = picture[..., :3] / 255.0, exact[..., :3] / 255.0
        covered = exact[..., 3] > 0
        rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
        part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if len(rows) else (slice(None),) * 2
        whole, box = min(whole, psnr(a, b)), min(box, psnr(a, b, part))
    return whole, box
