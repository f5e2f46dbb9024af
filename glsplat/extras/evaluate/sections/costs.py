"""Cost of avatars of different kinds at the same sizes: time, memory and triangles or splats, batched and not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.extras.evaluate.frames import WARM_UP, triangles_of
from glsplat.extras.evaluate.subjects import orbit, pose_of_frame
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose

PAPER = {512: (21.78, 37.47), 768: (23.19, 38.33), 1024: (25.45, 38.80)}
"""Ms per frame (with, without) Binocular Batching by picture side in pixels: the paper's rendering performance.

Measured by its authors on their GPU with their avatars; its FPS column is 1000 / ms, without encoding.
"""

SIZES = tuple(PAPER)


def costs(
    context: Context,
    figures: Mapping[str, Rigged],  # by name; of one person, as all have one camera
    sizes: Sequence[int] = SIZES,  # side of each eye's picture in pixels
    frames: int = 30,  # measured, after a warm-up
    tick: Callable[[], object] = lambda: None,  # called after each frame of each avatar
) -> list[dict[str, Any]]:
    """Return a row per avatar and size as JSON values, with the paper's values at this size.

    Times are median ms per frame, read back: ``pair_ms`` both eyes in one call, ``two_ms`` each eye by its own
    renderer, ``in_turn_ms`` eye by eye by one renderer, which poses once; ``gain`` is ``two_ms / pair_ms``. ``bytes``
    is the GPU memory of a renderer of pairs: the avatar and work buffers. Avatars take turns frame by frame, with the
    same motion and orbiting cameras.
    """
    rows: list[dict[str, Any]] = []
    for size in sizes if figures else ():
        samples: dict[str, list[tuple[float, float, float]]] = {name: [] for name in figures}
        with ExitStack() as stack:
            drawn = {
                name: [
                    stack.enter_context(Renderer(figure, size=(size, size), views=views, context=context))
                    for views in (2, 1, 1, 1)
                ]
                for name, figure in figures.items()
            }
            for frame in range(WARM_UP + frames):
                eyes = orbit(next(iter(figures.values())), frame, size)
                for name, figure in figures.items():
                    taken = _milliseconds(drawn[name], eyes, pose_of_frame(figure.skeleton, frame))
                    if frame >= WARM_UP:
                        samples[name].append(taken)
                    tick()
            for name, figure in figures.items():
                pair, two, in_turn = np.round(np.median(samples[name], axis=0), 3).tolist()
                row: dict[str, Any] = {"method": name, "size": size}
                if isinstance(figure, Avatar):
                    row |= {"kind": "splats", "count": len(figure.splats)}
                else:
                    row |= {"kind": "triangles", "count": triangles_of(figure)}
                row |= {"bytes": sum(drawn[name][0].nbytes().values()), "pair_ms": pair, "two_ms": two}
                row |= {"in_turn_ms": in_turn, "gain": round(two / pair, 3)}
                if size in PAPER:
                    batched, single = PAPER[size]
                    row["paper"] = {"pair_ms": batched, "two_ms": single, "gain": round(single / batched, 3)}
                rows.append(row)
    return rows


def _milliseconds(renderers: Sequence[Renderer], eyes: Sequence[Camera], pose: Pose) -> tuple[float, float, float]:
    """Return ms of one frame as a pair, by a renderer per eye, and eye by eye by one renderer."""
    pair, shared, *own = renderers
    pair.render(eyes, pose)
    two = in_turn = 0.0
    for renderer, eye in zip(own, eyes, strict=True):
        renderer.render([eye], pose)
        two += renderer.timings["total"]
    for eye in eyes:
        shared.render([eye], pose)
        in_turn += shared.timings["total"]
    return pair.timings["total"], two, in_turn
