"""Fit fewer splats to pictures of more: levels of detail, and avatars with fewer splats.

Neighbours are merged first; a fit (authoring/optimize) then brings the pictures of the merged splats close to those of
all. A coarse level is fitted to pictures as small as those in which it replaces the finest, where a splat covers a few
pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.finish.level_merge import merged
from glsplat.extras.authoring.geometry.attribute_transfer import transferred_shapes

Report = Callable[[str, float], None]

_MIN_SIZE_PX = 160  # a side, of a whole figure


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedConfig:
    """Parameters of a fit of fewer splats."""

    steps: int = 600  # for each level
    size: int = 768  # pixels a side of a whole figure, times (count / splats) ** power for fewer splats
    splats: int = 23_000
    power: float = 0.7
    poses: int = 64


def fitted_levels(
    avatar: Avatar,
    counts: Sequence[int],
    seed: int = 0,
    config: FittedConfig | None = None,
    progress: Report | None = None,
) -> tuple[Avatar, ...]:
    """Return avatars of ``counts`` splats (falling) fitted to ``avatar``; SH degree 0. Needs numba.

    Deterministic; each level is independent of the others.
    Raises GlsplatError for counts that do not fall from the avatar's own.
    """
    sizes = [len(avatar.splats), *counts]
    if any(not 0 < few < many for many, few in pairwise(sizes)):
        raise GlsplatError(f"levels need fewer and fewer splats below {sizes[0]}, not {', '.join(map(str, counts))}")
    made = []
    for index, count in enumerate(counts):

        def show(stage: str, done: float, index: int = index) -> None:
            if progress:
                progress(f"level {index + 1} of {len(counts)}: {stage}", (index + done) / len(counts))

        made.append(reduced(avatar, count, seed, config, show))
    return tuple(made)


def reduced(
    avatar: Avatar,
    count: int,
    seed: int = 0,
    config: FittedConfig | None = None,
    progress: Report | None = None,
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
