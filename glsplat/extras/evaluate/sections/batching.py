"""Binocular Batching: both eyes in one pass against two renders, beside the paper's table, and where the gain lies."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from glsplat.config import RenderConfig
from glsplat.extras.evaluate.frames import STAGES, WARM_UP, Binocular, Series
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context
from glsplat.renderer import Renderer

PAPER = {512: (21.78, 37.47), 768: (23.19, 38.33), 1024: (25.45, 38.80)}
"""Pixels a side -> (with, without) Binocular Batching, ms a frame: the paper's table of rendering performance.

Measured by its authors on their GPU with their avatars; its FPS column is 1000 / ms, without encoding.
"""


def batching(context: Context, subject: Subject, frames: int) -> dict[str, Any]:
    """One size: a pair in one pass; each eye in a renderer of its own, which shares nothing; one renderer, eye by eye.

    The last shares what does not depend on the eye (skinning), as ``glsplat bench`` measures it. Stages come from
    renderers that wait at every mark, so they add up to more than the frame.
    """
    size = (subject.size, subject.size)

    def make(views: int, timed: bool = False) -> Renderer:
        return Renderer(subject.scene, size=size, views=views, config=RenderConfig(), context=context, timed=timed)

    eyes_of = Binocular(make)
    staged_pair, staged_left, staged_right = make(2, True), make(1, True), make(1, True)
    together: list[float] = []
    apart: list[float] = []
    in_turn: list[float] = []
    stages: dict[str, tuple[list[float], list[float]]] = {}
    try:
        for frame in range(WARM_UP + frames):
            eyes, pose = subject.views(frame), subject.pose(frame)
            one_call, alone, turns = eyes_of.frame(eyes, pose)
            staged_pair.render(eyes, pose)
            for renderer, eye in zip((staged_left, staged_right), eyes, strict=True):
                renderer.render([eye], pose)
            if frame < WARM_UP:
                continue
            together.append(one_call)
            apart.append(alone)
            in_turn.append(turns)
            for stage in STAGES:
                one = staged_pair.timings.get(stage, 0.0)
                two = staged_left.timings.get(stage, 0.0) + staged_right.timings.get(stage, 0.0)
                both = stages.setdefault(stage, ([], []))
                both[0].append(one)
                both[1].append(two)
    finally:
        eyes_of.release()
        for renderer in (staged_pair, staged_left, staged_right):
            renderer.release()
    rows = []
    for stage, (one_pass, two_renders) in stages.items():
        if max(two_renders) > 0:
            a, b = float(np.median(one_pass)), float(np.median(two_renders))
            rows.append({"stage": stage, "pair_ms": round(a, 3), "two_ms": round(b, 3), "saved_ms": round(b - a, 3)})
    row = {
        "size": subject.size,
        "frames": frames,
        "pair_ms": asdict(Series.of(together)),
        "two_ms": asdict(Series.of(apart)),
        "in_turn_ms": asdict(Series.of(in_turn)),
        "gain": round(float(np.median(apart) / np.median(together)), 3),
        "in_turn_gain": round(float(np.median(in_turn) / np.median(together)), 3),
        "fps": round(1000 / float(np.median(together)), 2),
        "two_fps": round(1000 / float(np.median(apart)), 2),
        "stages": rows,
    }
    paper = paper_of(subject.size)
    return row if paper is None else row | {"paper": paper}


def paper_of(size: int) -> dict[str, float] | None:
    """The paper's row of that many pixels a side: pair_ms, two_ms, gain; None where it has none."""
    if size not in PAPER:
        return None
    with_bb, without = PAPER[size]
    return {"pair_ms": with_bb, "two_ms": without, "gain": round(without / with_bb, 3)}
