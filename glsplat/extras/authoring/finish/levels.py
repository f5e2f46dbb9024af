"""Levels of detail: fitted, or merged with their coverage tuned to pictures of the finest; then measured.

A fit of fewer splats merges neighbours, then brings their pictures close to those of all splats. A coarse level is
fitted to pictures as small as those in which it replaces the finest, where a splat covers a few pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.compute.compiled import available
from glsplat.extras.authoring.finish.level_measure import MeasureConfig, Pictures, Viewpoint, measured, viewpoints_of
from glsplat.extras.authoring.finish.level_merge import Cover, area_of, covered, merged, merged_levels
from glsplat.extras.authoring.geometry.attribute_transfer import transferred_shapes
from glsplat.splats import Splats

Report = Callable[[str, float], None]
_MIN_SIZE_PX = 160  # a side, of a whole figure
Scene = TypeVar("Scene", bound=Splats | Avatar)
MIN_LEVEL_SPLATS = 5000
"""Splats of the coarsest level by default."""
_MAX_LEVELS = 8
_GAINS = (0.7, 0.85, 1.0, 1.2, 1.4, 1.7)
_GROWTHS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
_TUNING_VIEWS = 4  # for the choice of gain and growth


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedConfig:
    """Parameters of a fit of fewer splats."""

    steps: int = 600  # for each level
    size: int = 768  # pixels a side of a whole figure, times (count / splats) ** power for fewer splats
    splats: int = 23_000
    power: float = 0.7
    poses: int = 64


def _silent(stage: str, done: float) -> None: ...


def fitted_levels(
    avatar: Avatar, counts: Sequence[int], seed: int = 0, config: FittedConfig | None = None, report: Report = _silent
) -> list[Avatar]:
    """Return avatars of each of ``counts`` splats fitted to ``avatar``; SH degree 0. Deterministic. Needs numba."""
    made = []
    for index, count in enumerate(counts):

        def show(stage: str, done: float, index: int = index) -> None:
            report(f"level {index + 1} of {len(counts)}: {stage}", (index + done) / len(counts))

        made.append(reduced(avatar, count, seed, config, show))
    return made


def reduced(
    avatar: Avatar, count: int, seed: int = 0, config: FittedConfig | None = None, progress: Report | None = None
) -> Avatar:
    """Return an avatar of ``count`` splats fitted to pictures of ``avatar``; SH degree 0, no levels, no cones.

    Needs numba, except with 0 steps, which only merge.
    """
    config = config or FittedConfig()
    bare = replace(avatar, levels=(), splats=replace(avatar.splats, cones=None, cones_psnr=None))
    start = merged(bare, count)
    if not config.steps:
        return start
    from glsplat.extras.authoring.optimize.splat_fit import FitConfig, fitted
    from glsplat.extras.authoring.optimize.target_pictures import ViewConfig, pictures_of_splats

    size = max(_MIN_SIZE_PX, round(config.size * min(1.0, (count / config.splats) ** config.power)))
    views = ViewConfig(body=12, poses=config.poses, each=1, size=size, close=size // 2)
    pictures = pictures_of_splats(bare, seed, views, progress)
    fit = FitConfig(steps=config.steps, scale_decay=0.08, recycled_fraction=0.0)
    made = fitted(replace(start, shapes=None), pictures, seed, fit, progress)
    shapes = None if start.shapes is None else transferred_shapes(start.shapes, start.splats, made.splats)
    return replace(made, shapes=shapes)


def halves(count: int) -> list[int]:
    """Return ``count`` / 2, / 4, ... down to 5,000; below 10,000 only the half."""
    out = [count // 2]
    while len(out) < _MAX_LEVELS and out[-1] // 2 >= MIN_LEVEL_SPLATS:
        out.append(out[-1] // 2)
    return [one for one in out if one > 0]


def with_levels(
    scene: Scene,
    counts: Sequence[int] | None = None,  # falling, each below the finest's; default: halves
    seed: int = 0,
    steps: int = FittedConfig().steps,
    config: MeasureConfig | None = None,
    progress: Report | None = None,
) -> Scene:
    """Return ``scene`` with new levels, without those that keep ``config.psnr`` nowhere.

    Levels of an avatar are fitted in ``steps`` each. Levels of static splats, with 0 steps, or without numba are merged
    only. Raises GlsplatError for counts that do not fall from below the number of splats, and where no splat can be
    drawn.
    """
    config, report = config or MeasureConfig(), progress or _silent
    bare: Any = replace(scene, levels=())  # type: ignore[arg-type]
    total = len(splats_of(bare))
    counts = halves(total) if counts is None else counts
    if not counts or any(not 0 < few < many for many, few in pairwise([total, *counts])):
        raise GlsplatError(f"levels need fewer and fewer splats below {total}, not {', '.join(map(str, counts))}")
    if isinstance(scene, Avatar) and steps and available():
        levels = fitted_levels(bare, counts, seed, FittedConfig(steps=steps), report)
    else:
        levels = covering_levels(bare, counts, config, report)
    made: Scene = replace(bare, levels=measured(bare, levels, config, report))
    return made


def covering_levels(scene: Any, counts: Sequence[int], config: MeasureConfig, report: Report = _silent) -> list[Any]:
    """Return the scene merged to each of ``counts``, with the coverage that pictures of the finest ask for."""
    raw = merged_levels(scene, counts, report)
    viewpoints = viewpoints_of(scene, config)
    tuning = viewpoints[:: max(1, len(viewpoints) // _TUNING_VIEWS)]
    levels, cover = [], Cover()
    with Pictures([scene, raw[0]], tuning, config.size) as pictures:
        for number, one in enumerate(raw):
            report("matching the coverage of levels", number / len(raw))
            cover = _matched(one, tuning, pictures, config, cover)
            levels.append(covered(one, cover))
    return levels


def _matched(
    raw: Any, viewpoints: Sequence[Viewpoint], pictures: Pictures, config: MeasureConfig, start: Cover
) -> Cover:
    """Return the cover with the least error against the finest, where a splat is about one pixel or half of one."""
    splats = splats_of(raw)
    spacing = float(np.sqrt(2 * np.pi * area_of(np.abs(splats.scales.astype(np.float64))).mean()))
    largest = min(config.size / one.extent * one.unit for one in viewpoints if not one.inside)
    density = min(1 / spacing, largest)
    errors: dict[Cover, float] = {}

    def error(cover: Cover) -> float:
        if cover not in errors:
            pictures.replace_scene(1, covered(raw, cover))
            kept = [*pictures.psnrs(1, density), *pictures.psnrs(1, density / 2)]
            errors[cover] = float(np.mean([10 ** (-one / 10) for one in kept]))
        return errors[cover]

    best = start
    for key, values in (("grow", _GROWTHS), ("gain", _GAINS), ("grow", _GROWTHS)):
        for step in (1, -1):
            while 0 <= (at := values.index(getattr(best, key)) + step) < len(values):
                other = replace(best, **{key: values[at]})
                if error(other) >= error(best):
                    break
                best = other
    return best
