"""Levels of detail of one item on the GPU: each is staged when it is first drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.renderer.proxy import Proxy
from glsplat.renderer.stage import ItemBuffers, Placement
from glsplat.splats import Splats

__all__ = ["LevelBuffers"]

_numbers = count()  # in the whole process: a Selector may follow its viewer from one renderer to another


class LevelBuffers:
    """The buffers of an item's levels. ``make`` makes those of one level; ``number`` is no other item's."""

    def __init__(self, content: Splats | Avatar, make: Callable[[Splats | Avatar], ItemBuffers]) -> None:
        self.number: int = next(_numbers)
        self.contents: tuple[Splats | Avatar, ...] = (content, *(level.content for level in content.levels))
        self.densities: tuple[float, ...] = tuple(level.density for level in content.levels)
        self._make = make
        self._made: dict[int, ItemBuffers] = {}
        self._proxy: Proxy | None = None

    @property
    def has_cones(self) -> bool:
        """Whether hidden splats can be left out of any level."""
        splats = (one.splats if isinstance(one, Avatar) else one for one in self.contents)
        return any(one.cones is not None for one in splats)

    @property
    def coarsest(self) -> int:
        """The number of the coarsest level; 0 is the finest."""
        return len(self.densities)

    @property
    def nbytes(self) -> int:
        """GPU bytes of the levels that were drawn."""
        return sum(buffers.nbytes for buffers in self._made.values())

    def density(self, place: Placement, views: Sequence[Camera]) -> float:
        """Pixels a metre (of its own) at which the views show it, the densest counts; 0 where none shows it."""
        if self._proxy is None:
            self._proxy = Proxy.of(self.contents[0])  # by which its levels were measured (making.detail)
        to_world = None
        if not place.unmoved:
            to_world = np.eye(4)
            to_world[:3, :3], to_world[:3, 3] = place.size * place.turn, place.offset
        return max((self._proxy.density(view, to_world, place.bones) for view in views), default=0.0)

    def count(self, level: int) -> int:
        """Splats of a level."""
        content = self.contents[level]
        return len(content.splats if isinstance(content, Avatar) else content)

    def get(self, level: int) -> ItemBuffers:
        """The buffers of a level."""
        if level not in self._made:
            self._made[level] = self._make(self.contents[level])
        return self._made[level]

    def release(self) -> None:
        """Delete all buffers."""
        made, self._made = self._made, {}
        for buffers in made.values():
            buffers.release()
