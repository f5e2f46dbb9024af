"""Which size of pictures a server can draw often enough, found out once at its start."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

__all__ = ["ENOUGH", "SIDES", "Fitted", "fit"]

ENOUGH = 15.0
"""Pictures a second, for one client who sees with two eyes."""
SIDES = (1024, 768, 512)
"""Of square pictures, the largest first."""
_WARM = 1  # pictures that are not counted: the first makes what later ones find
_COUNTED = 2
_HOPE = 0.6  # a part of a picture's time does not grow with its pixels


@dataclass(frozen=True, slots=True)
class Fitted:
    """``side`` pixels, at which about ``rate`` pictures a second can be drawn."""

    side: int
    rate: float

    @property
    def enough(self) -> bool:
        """Whether that is a picture that moves."""
        return self.rate >= ENOUGH


async def fit(draw: Callable[[int], Awaitable[float]], most: int = SIDES[0]) -> Fitted:
    """The largest of SIDES up to ``most`` that is drawn ENOUGH times a second, else the smallest.

    ``draw`` has a pair of that side drawn and returns the seconds that it took; of several the fastest counts, because
    a machine that has just started is busy with more than that. The smallest comes first, and only those are tried that
    could be fast enough by their pixels: a slow machine is not kept from starting.
    """
    sides = [side for side in SIDES if side <= most] or [most]
    least = min(sides)
    found = Fitted(least, await _rate(draw, least))
    for side in sides:
        if side == least or found.rate * (least / side) ** 2 < _HOPE * ENOUGH:
            continue
        rate = await _rate(draw, side)
        if rate >= ENOUGH:
            return Fitted(side, rate)
    return found


async def _rate(draw: Callable[[int], Awaitable[float]], side: int) -> float:
    for _ in range(_WARM):
        await draw(side)
    return 1.0 / max(min([await draw(side) for _ in range(_COUNTED)]), 1e-4)
