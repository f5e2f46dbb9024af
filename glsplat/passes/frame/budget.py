"""Budget: what one picture may cost. Its cost is known before it is drawn, and a costly one is drawn in slices."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from glsplat.errors import BudgetError

__all__ = ["BLOCK_PIXELS", "Budget"]

BLOCK_PIXELS = 16
"""Pixels of a block of 4x4: the unit in which key.vert.glsl counts, and the least that rasterizers work on."""


class Budget:
    """Limits of one picture; make a new one for each.

    Cost is in covered pixels: over all views and all splats that are drawn, the pixels of the box around the splat
    inside the picture, in whole blocks of 4x4.
    """

    def __init__(
        self,
        max_cost: float = math.inf,  # covered pixels; a picture above it is refused before anything is drawn
        seconds: float = math.inf,  # from now on; later it is abandoned between two slices
        slice_cost: float = math.inf,  # covered pixels; a picture above it is drawn in slices of about that much
        abandoned: Callable[[], bool] = lambda: False,  # asked between slices: does nobody want it any more?
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.cost = 0  # of the passes so far
        self.slice_cost = slice_cost
        self._max_cost, self._seconds = max_cost, seconds
        self._abandoned, self._clock = abandoned, clock
        self._start = clock()

    def spend(self, cost: int) -> None:
        """A pass of that cost is about to be drawn. Raises BudgetError (too_costly) if that is more than is left."""
        self.cost += cost
        if self.cost > self._max_cost:
            raise BudgetError(
                f"the picture covers {self.cost:.3g} pixels splat by splat, at most {self._max_cost:.3g} are drawn; "
                "ask for a smaller size or look from further away",
                "too_costly",
            )

    def check(self) -> None:
        """Go on? Raises BudgetError (abandoned, too_slow) if not."""
        if self._abandoned():
            raise BudgetError("nobody waits for the picture any more", "abandoned")
        if self._clock() - self._start > self._seconds:
            raise BudgetError(
                f"the picture took more than {self._seconds:g} s; ask for a smaller size or look from further away",
                "too_slow",
            )
