"""``glsplat avatar make --levels``: which levels of detail are asked for, and the avatar with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

from glsplat.avatar import Avatar
from glsplat.making.cones import with_cones
from glsplat.making.detail.fitted import fitted_levels
from glsplat.making.detail.make import with_merged_levels
from glsplat.making.detail.measure import measured
from glsplat.making.optimize.compiled import available
from glsplat.making.surface import FEWEST

from ..usage import UsageError

__all__ = ["COARSEST", "counts_of", "with_levels"]

COARSEST = 5000
"""Splats below which no level is made unless it is asked for."""


def counts_of(asked: Sequence[str] | None, splats: int) -> tuple[int, ...]:
    """Splats of the levels below ``splats``: halves down to COARSEST for None, none for ``none``. Raises UsageError."""
    if asked is None:
        halves = [splats >> k for k in range(1, 32)]
        return tuple(half for half in halves if half >= COARSEST)
    if list(asked) in (["none"], ["0"]):
        return ()
    counts = [int(word) if word.isascii() and word.isdigit() else 0 for word in asked]
    if not counts or min(counts) < FEWEST or any(few >= many for many, few in pairwise((splats, *counts))):
        raise UsageError(
            f"--levels needs falling numbers of splats below {splats}, none under {FEWEST}, or none; "
            f"not {' '.join(asked) or 'nothing'}"
        )
    return tuple(counts)


def with_levels(
    avatar: Avatar,
    counts: Sequence[int],
    seed: int,
    cones: bool,
    progress: Callable[[str, float], None] | None = None,
) -> Avatar:
    """The avatar with levels, each with ``cones`` where asked for, and its density: fitted where numba is installed,
    merged elsewhere."""
    if not available():
        made = with_merged_levels(avatar, counts, progress=progress)
        if not cones:
            return made
        return replace(
            made, levels=tuple(replace(one, content=with_cones(one.content, progress=progress)) for one in made.levels)
        )
    levels = fitted_levels(avatar, counts, seed, progress=progress)
    if cones:
        levels = tuple(with_cones(level, progress=progress) for level in levels)
    return replace(avatar, levels=measured(avatar, levels, progress=progress))
