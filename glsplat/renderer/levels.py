"""Selector: which level of detail a view gets of each thing, and the memory that keeps it from flickering."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from glsplat.arrays import number
from glsplat.config import MAX_BIAS
from glsplat.errors import GlsplatError

__all__ = ["BAND", "Selector", "chosen"]

BAND = 1.05
"""Hysteresis: a level is kept until the view wants that much more than it has, or less than the coarser one has."""


class Selector:
    """The levels that one viewer had. Where several look in turn each has its own (``Renderer.selector``).

    ``bias`` is added to ``RenderConfig.lod_bias``, in halvings, -8 to 8.
    """

    def __init__(self, bias: float = 0.0) -> None:
        self.bias = bias
        self.coarsest: bool = True  # no thing in view had a coarser level than it got last
        self._last: dict[int, int] = {}  # level by the thing's number

    @property
    def bias(self) -> float:
        """Above 0 for finer levels than suffice, below for coarser ones. GlsplatError beyond -8 to 8."""
        return self._bias

    @bias.setter
    def bias(self, bias: float) -> None:
        self._bias = number(bias, "bias", GlsplatError)
        if not -MAX_BIAS <= self._bias <= MAX_BIAS:
            raise GlsplatError(f"bias needs -{MAX_BIAS:g} to {MAX_BIAS:g}, not {self._bias:g}")

    def choose(self, things: Iterable[tuple[int, Sequence[float], float]], bias: float = 0.0) -> list[int]:
        """The level of each thing, given as its number, the densities of its coarser levels, and that of the view.

        Densities are pixels a metre; 0 where no view shows it: what nobody sees keeps the level it has.
        """
        finer, before = 2.0 ** (bias + self.bias), self._last
        found: dict[int, int] = {}
        self.coarsest = True
        for key, densities, density in things:
            last = before.get(key)
            if density > 0:
                found[key] = chosen(densities, density * finer, last)
                self.coarsest &= found[key] == len(densities)
            else:
                found[key] = len(densities) if last is None else last
        self._last = found
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
