"""Leaving out hidden splats: what it saves against the draw floor, and where it fails worst.

The visibility cones of a scene (authoring.finish.cones) were made from some directions in some poses. Here the scene
is drawn with and without them from many directions, an avatar in moments of all embedded motions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar, splats_of
from glsplat.camera import Camera
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.difference import Difference
from glsplat.extras.evaluate.frames import FOV, WARM_UP, Series
from glsplat.extras.evaluate.subjects import Subject
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.gl.context import Context
from glsplat.renderer.probe import Probe
from glsplat.skinning.pose import Pose
from glsplat.views import view_of, viewing_point

__all__ = ["Search", "hidden", "with_hidden"]

CULLED = RenderConfig(cull_hidden=True)
WANTED = {512: 0.75, 1024: 0.6}
"""Pixels a side -> share of the unculled draw floor that a whole frame may take, at 45 dB."""


@dataclass(frozen=True)
class Search:
    """How the worst picture is looked for, and how long a frame is timed."""

    sizes: tuple[int, ...] = (512, 1024)
    frames: int = 30
    moments: int = 3  # of each motion
    around: int = 6  # directions
    elevations: tuple[float, ...] = (-20.0, 10.0, 50.0)  # degrees
    size: int = 512  # pixels a side of the pictures compared


def with_hidden(subjects: Sequence[Subject]) -> list[Subject]:
    """Those that have visibility cones and no camera of their own."""
    return [s for s in subjects if splats_of(s.scene).cones is not None and not s.cameras]


def hidden(
    context: Context, subjects: Sequence[Subject], search: Search
) -> tuple[list[dict[str, Any]], dict[str, NDArray[np.float32]]]:
    """A row a subject, and by its name the worst picture: left out, and complete, side by side [H, 2 W, 4]."""
    rows, pictures = [], {}
    for subject in subjects:
        price = []
        for size in search.sizes:
            price.append(_price(context, subject, size, search.frames))
        worst, picture = _worst(context, subject, search)
        rows.append({"scene": subject.name, "splats": len(splats_of(subject.scene)), "price": price, **worst})
        pictures[subject.name] = picture
    return rows, pictures


def _price(context: Context, subject: Subject, size: int, frames: int) -> dict[str, Any]:
    """Whole frames with and without hidden splats, and the draw floor of all, interleaved; how far apart they are."""
    seen = replace(subject, size=size)

    def make(config: RenderConfig) -> Probe:
        return Probe(seen.scene, size=(size, size), views=2, config=config, context=context)

    whole: list[float] = []
    floor: list[float] = []
    culled: list[float] = []
    apart: list[Difference] = []
    with make(RenderConfig()) as plain, make(CULLED) as less:
        for frame in range(WARM_UP + frames):
            views, pose = seen.views(frame), seen.pose(frame)
            plain.render(views, pose)
            lowest = plain.redraw(views)
            less.render(views, pose)
            if frame >= WARM_UP:
                whole.append(plain.timings["total"])
                floor.append(lowest)
                culled.append(less.timings["total"])
        drawn, all_drawn = less.stats.drawn, plain.stats.drawn
    with make(_float(RenderConfig())) as plain, make(_float(CULLED)) as less:
        for frame in {WARM_UP, WARM_UP + frames // 2, WARM_UP + frames - 1}:
            views, pose = seen.views(frame), seen.pose(frame)
            right = plain.render(views, pose).astype(np.float64)
            apart.append(Difference.of(less.render(views, pose), right, flip=False))
    ratio = float(np.median(culled)) / float(np.median(floor))
    return {
        "size": size,
        "whole_ms": asdict(Series.of(whole)),
        "floor_ms": asdict(Series.of(floor)),
        "culled_ms": asdict(Series.of(culled)),
        "to_floor": round(ratio, 3),
        "wanted": WANTED.get(size),
        "drawn": round(drawn / max(all_drawn, 1), 3),
        "psnr": Difference.worst(apart).psnr,
    }


def _worst(context: Context, subject: Subject, search: Search) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """PSNR of every picture looked at, and where the smallest was."""
    size, where = (search.size, search.size), ""
    found: list[float] = []
    picture = np.zeros((search.size, 2 * search.size, 4), np.float32)
    with (
        Probe(subject.scene, size=size, config=_float(RenderConfig()), context=context) as plain,
        Probe(subject.scene, size=size, config=_float(CULLED), context=context) as less,
    ):
        for name, pose in _poses(subject, search):
            for text, views in _directions(subject, search):
                complete, left = plain.render(views, pose), less.render(views, pose)
                psnr = Difference.of(left, complete.astype(np.float64), flip=False).psnr
                if not found or psnr < min(found):
                    where, picture = f"{name}, {text}", np.concatenate([left[0], complete[0]], axis=1)
                found.append(psnr)
    low, middle = (round(float(v), 2) for v in np.percentile(found, (5, 50)))
    row = {"size": search.size, "pictures": len(found), "psnr": min(found), "psnr_p5": low, "psnr_median": middle}
    return {"worst": {**row, "where": where}}, picture


def _poses(subject: Subject, search: Search) -> Iterator[tuple[str, Pose | None]]:
    yield "at rest", None
    if not isinstance(subject.scene, Avatar) or not subject.moving:
        return
    for name in embedded_motions():
        try:
            motion = load_motion(name, subject.scene.skeleton)
        except GlsplatError:  # another rig
            continue
        length = len(motion.rotations) / motion.fps
        for moment in range(search.moments):
            seconds = length * (moment + 0.5) / search.moments
            yield f"{name} at {seconds:.2f} s", motion.at(seconds)


def _directions(subject: Subject, search: Search) -> Iterator[tuple[str, list[Camera]]]:
    eye, target = viewing_point(subject.scene, FOV)
    distance = float(np.linalg.norm(eye - target))
    for elevation in search.elevations:
        for index in range(search.around):
            azimuth = 360 * index / search.around
            a, e = np.radians(azimuth), np.radians(elevation)
            way = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
            views = view_of(target + distance * way, target, (search.size, search.size), FOV)
            yield f"seen from {azimuth:.0f} degrees to its left, {elevation:.0f} above", views


def _float(config: RenderConfig) -> RenderConfig:
    return replace(config, output="float32", target="32f")
