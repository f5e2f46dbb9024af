"""What avatars of different kinds cost at the same sizes: time, memory and triangles or splats, batched and not."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from glsplat.avatar import Avatar
from glsplat.extras.evaluate.frames import WARM_UP, Binocular, Series, triangles_of
from glsplat.extras.evaluate.sections.batching import paper_of
from glsplat.extras.evaluate.subjects import orbit, pose_of_frame
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Rigged

SIZES = (512, 768, 1024)
"""Pixels a side of each eye: those of the paper's table of rendering performance."""


@dataclass(frozen=True)
class Cost:
    """One avatar at one size; milliseconds a frame, read back."""

    name: str
    size: int  # pixels a side of each eye
    kind: str  # "triangles" or "splats"
    count: int  # of them
    nbytes: int  # of GPU memory for what is drawn and the work buffers, by one renderer of pairs
    pair: Series  # both eyes in one call
    two: Series  # each eye by a renderer of its own
    in_turn: Series  # eye by eye by one renderer, which poses once

    @property
    def gain(self) -> float:
        """How much longer two renders take than the pair."""
        return round(self.two.median / self.pair.median, 3)

    def row(self) -> dict[str, Any]:
        """The medians as JSON values, beside the paper's at this size."""
        out = {"method": self.name, "size": self.size, "kind": self.kind, "count": self.count, "bytes": self.nbytes}
        out |= {"pair_ms": self.pair.median, "two_ms": self.two.median, "in_turn_ms": self.in_turn.median}
        paper = paper_of(self.size)
        return out | {"gain": self.gain} | ({} if paper is None else {"paper": paper})


def costs(
    context: Context,
    figures: Mapping[str, Rigged],  # by name; of one person, so that one camera is right for all
    sizes: Sequence[int] = SIZES,
    frames: int = 30,  # measured, after a warm-up
    tick: Callable[[], object] = lambda: None,  # called after each frame of each avatar
) -> list[Cost]:
    """A row an avatar and size. All move by the same motion under the same orbiting pair, frame by frame in turn."""
    if not figures:
        return []
    first = next(iter(figures.values()))
    out = []
    for size in sizes:
        samples: dict[str, list[tuple[float, float, float]]] = {name: [] for name in figures}
        with ExitStack() as stack:
            drawn = {}
            for name, figure in figures.items():
                make = partial(_renderer, context, figure, size)
                drawn[name] = Binocular(make)
                stack.callback(drawn[name].release)
            for frame in range(WARM_UP + frames):
                eyes = orbit(first, frame, size)
                for name, figure in figures.items():
                    taken = drawn[name].frame(eyes, pose_of_frame(figure.skeleton, frame))
                    if frame >= WARM_UP:
                        samples[name].append(taken)
                    tick()
            for name, figure in figures.items():
                splats = isinstance(figure, Avatar)
                count = len(figure.splats) if isinstance(figure, Avatar) else triangles_of(figure)
                nbytes = sum(drawn[name].pair.nbytes().values())
                series = (Series.of(values) for values in np.transpose(samples[name]).tolist())
                out.append(Cost(name, size, "splats" if splats else "triangles", count, nbytes, *series))
    return out


def _renderer(context: Context, figure: Rigged, size: int, views: int) -> Renderer:
    return Renderer(figure, size=(size, size), views=views, context=context)
