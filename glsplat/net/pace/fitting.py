"""Which size of pictures a server can draw often enough, found out once at its start."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

__all__ = ["ENOUGH", "SIDES", "Fitted", "fit"]

ENOUGH = 15.0
"""Pictures a second, for one client who sees with two eyes."""
SIDES = (1024, 768, 512)
"""Of square pictures, the largest first."""
_WARM = 1  # pictures that are not counted: the first makes what later ones find
_COUNTED = 2


@dataclass(frozen=True, slots=True)
class Fitted:
    """``side`` pixels, at which about ``rate`` pictures a second can be drawn."""

    side: int
    rate: float

    @property
    def enough(self) -> bool:
        """Whether that is a picture that moves."""
        return self.rate >= ENOUGH


async def fit(draw: Callable[[int], Awaitable[float]], sides: Sequence[int] = SIDES) -> Fitted:
    """The largest of ``sides`` that is drawn ENOUGH times a second, else the smallest.

    ``draw`` has a pair of that side drawn and returns the seconds that it took; of several the fastest counts, because
    a machine that has just started is busy with more than that.
    """
    found = Fitted(sides[-1], 0.0)
    for side in sides:
        for _ in range(_WARM):
            await draw(side)
        took = min([await draw(side) for _ in range(_COUNTED)])
        found = Fitted(side, 1.0 / max(took, 1e-4))
        if found.enough:
            break
    return found
