"""Levels of detail of one item on the GPU: each is staged when it is first drawn; and which of them a view gets."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from glsplat.avatar import Avatar
from glsplat.camera import Camera
from glsplat.detail.proxy import Proxy
from glsplat.errors import GlsplatError
from glsplat.passes.item.buffers import ItemBuffers, Placement
from glsplat.splats import Splats

__all__ = ["BAND", "Choices", "LevelBuffers", "Look", "chosen"]

BAND = 1.05
"""Hysteresis: a level is kept until the view wants that much more than it has, or less than the coarser one has."""


_VIEWERS = 64
"""Viewers whose levels are remembered."""


@dataclass(frozen=True, slots=True)
class Look:
    """Who looks at the scene, from where, and how closely."""

    views: tuple[Camera, ...] = ()
    viewer: Hashable = None
    bias: float = 0.0  # as RenderConfig.lod_bias

    def __post_init__(self) -> None:
        try:
            hash(self.viewer)
        except TypeError:
            raise GlsplatError(f"viewer needs something hashable, not {type(self.viewer).__name__}") from None


class LevelBuffers:
    """The buffers of an item's levels. ``make`` makes those of one level; ``number`` is no other item's."""

    def __init__(self, content: Splats | Avatar, make: Callable[[Splats | Avatar], ItemBuffers], number: int) -> None:
        self.number = number
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


class Choices:
    """The level that each viewer had of each thing, so that it does not flicker between two."""

    def __init__(self) -> None:
        self.coarsest = True  # no thing in view had a coarser level than it got last
        self._memory: OrderedDict[Hashable, dict[int, int]] = OrderedDict()  # by viewer: level by number

    def choose(self, levels: Sequence[LevelBuffers], places: Sequence[Placement], look: Look) -> list[int]:
        """The level of each thing."""
        before = self._memory.get(look.viewer, {})
        finer = 2.0**look.bias
        found: dict[int, int] = {}
        self.coarsest = True
        for one, place in zip(levels, places, strict=True):
            key, last = one.number, before.get(one.number)
            density = one.density(place, look.views)
            if density > 0:
                found[key] = chosen(one.densities, density * finer, last)
                self.coarsest &= found[key] == one.coarsest
            else:  # what nobody sees keeps the level it has
                found[key] = one.coarsest if last is None else last
        self._memory[look.viewer] = found
        self._memory.move_to_end(look.viewer)
        while len(self._memory) > _VIEWERS:
            self._memory.popitem(last=False)
        return list(found.values())


def chosen(densities: Sequence[float], wanted: float, before: int | None = None) -> int:
    """The coarsest level that suffices where a view has ``wanted`` pixels a metre; 0 is the finest.

    ``densities`` are those of the coarser levels, falling (Splats.levels). ``before`` is the level that the same view
    had: near the limit between two it stays.

    >>> chosen((800, 400, 200), 300), chosen((800, 400, 200), 405), chosen((800, 400, 200), 405, before=2)
    (2, 1, 2)
    """

    def suffices(least: float) -> int:
        return sum(density >= least for density in densities)

    level = suffices(wanted)
    if before is None or level == before:
        return level
    if level > before:
        return max(before, suffices(wanted * BAND))
    return min(before, suffices(wanted / BAND))
