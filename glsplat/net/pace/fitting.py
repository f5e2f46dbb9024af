"""Finds the largest size of pictures that a server draws often enough, once at its start."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

MIN_FPS = 15.0  # of pairs of pictures, for one client
SIDES_PX = (1024, 768, 512)  # of square pictures, the largest first
_WARM_UP = 1  # pictures that fill caches and are not timed
_TIMED = 2  # pictures
_MIN_PREDICTED_SHARE = 0.6  # of MIN_FPS: a part of a picture's time does not grow with its pixels


@dataclass(frozen=True, slots=True)
class Fitted:
    """A size: about ``rate`` pictures a second of ``side`` pixels can be drawn."""

    side: int
    rate: float

    @property
    def enough(self) -> bool:
        """Whether the rate suffices for moving pictures."""
        return self.rate >= MIN_FPS


async def fit(draw: Callable[[int], Awaitable[float]], most: int = SIDES_PX[0]) -> Fitted:
    """Return the largest of SIDES_PX up to ``most`` that is drawn MIN_FPS times a second, else the smallest.

    ``draw`` draws a pair of a side and returns the seconds that it took; the fastest counts, because a starting machine
    is busy. The smallest side is tried first, then those whose pixels predict a sufficient rate, to keep the start of a
    slow machine short.
    """
    sides = [side for side in SIDES_PX if side <= most] or [most]
    least = min(sides)
    found = Fitted(least, await _rate(draw, least))
    for side in sides:
        if side == least or found.rate * (least / side) ** 2 < _MIN_PREDICTED_SHARE * MIN_FPS:
            continue
        rate = await _rate(draw, side)
        if rate >= MIN_FPS:
            return Fitted(side, rate)
    return found


async def _rate(draw: Callable[[int], Awaitable[float]], side: int) -> float:
    for _ in range(_WARM_UP):
        await draw(side)
    return 1.0 / max(min([await draw(side) for _ in range(_TIMED)]), 1e-4)
