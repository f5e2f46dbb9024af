"""``glsplat avatar make --levels``: which levels of detail are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from glsplat.authoring.surface import FEWEST

from ..usage import UsageError

__all__ = ["COARSEST", "counts_of"]

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
