"""Which size of pictures a server can draw often enough, found out once at its start."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

__all__ = ["MIN_FPS", "SIDES_PX", "Fitted", "fit"]

MIN_FPS = 15.0
"""Pictures a second, for one client who sees with two eyes."""
SIDES_PX = (1024, 768, 512)
"""Of square pictures, the largest first."""
_WARM_UP = 1  # pictures that are not counted: the first makes what later ones find
_TIMED = 2
_MIN_PREDICTED_SHARE = 0.6  # a part of a picture's time does not grow with its pixels


@dataclass(frozen=True, slots=True)
class Fitted:
    """``side`` pixels, at which about ``rate`` pictures a second can be drawn."""

    side: int
    rate: float

    @property
    def enough(self) -> bool:
        """Whether that is a picture that moves."""
        return self.rate >= MIN_FPS


async def fit(draw: Callable[[int], Awaitable[float]], most: int = SIDES_PX[0]) -> Fitted:
    """The largest of SIDES_PX up to ``most`` that is drawn MIN_FPS times a second, else the smallest.

    ``draw`` has a pair of that side drawn and returns the seconds that it took; of several the fastest counts, because
    a machine that has just started is busy with more than that. The smallest comes first, and only those are tried that
    could be fast enough by their pixels: a slow machine is not kept from starting.
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
