"""Drawable: an arena, what it is made of, and the pipelines that draw it.

Pipelines (order, records) are kept by variant, size and place in the call, so that clients of several sizes that take
turns, or several passes of one frame, do not overwrite each other's.
"""

from __future__ import annotations

from collections.abc import Callable

from glsplat.renderer.arena import Arena
from glsplat.renderer.lru_cache import LruCache
from glsplat.renderer.pipeline import Pipeline
from glsplat.shaders import Variant

__all__ = ["PASSES", "Drawable", "Part"]

PASSES = 4
"""Passes of one call that keep records of their own; later ones share the last place."""

_KEPT = 8
"""Pipelines that are kept at most."""

_KEPT_BYTES = 256 * 2**20
"""What pipelines other than the one in use may take."""

Part = tuple[int, int]
"""Number of a visible item, and its level of detail."""

Key = tuple[Variant, tuple[int, int], int]


class Drawable:
    """Owns the arena and its pipelines. ``parts`` are what the arena holds, in its order."""

    def __init__(self, arena: Arena, parts: tuple[Part, ...]) -> None:
        self.arena, self.parts = arena, parts
        self.pipelines: LruCache[Key, Pipeline] = LruCache(_KEPT, _KEPT_BYTES)

    @property
    def nbytes(self) -> int:
        """GPU bytes of all of it."""
        return self.arena.nbytes + self.arena.colour_nbytes + self.pipelines.nbytes

    def pipeline(self, variant: Variant, size: tuple[int, int], ordinal: int, make: Callable[[], Pipeline]) -> Pipeline:
        """What draws pictures of ``size`` as pass number ``ordinal`` of a call."""
        return self.pipelines.get((variant, size, min(ordinal, PASSES - 1)), make)

    def release(self) -> None:
        """Delete everything; may be called twice."""
        self.pipelines.release()
        self.arena.release()
