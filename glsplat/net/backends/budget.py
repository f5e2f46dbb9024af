"""PictureBudget: limits the cost of a picture, which is known before it is drawn; costly ones are drawn in slices."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from glsplat.camera import Camera
from glsplat.errors import BudgetError

if TYPE_CHECKING:
    from glsplat.renderer import Prepared
    from glsplat.renderer.checks import Images
    from glsplat.renderer.read_back import Transfer

_FULL_SHARE_PIXELS = 2 * 2048 * 2048  # of a picture whose full cost others may use; in proportion for smaller ones
_ONE_PERSON = 0.5  # limit for one person, as a share of the limit for all others
_MIN_SPLAT_PIXELS = 64  # covered pixels of each splat and view that are granted in any picture: four blocks


def others_share(max_cost: float, views: Sequence[Camera], splats: int, each: bool = False) -> float:
    """Return the covered pixels that a room's other people, of that many ``splats``, may add to a viewer's picture.

    The limit is for all of them, or for ``each``. A person whose eyes nearly touch the viewer's needs four fifths of
    the limit for one, a circle of eight people two fifths of the limit for all (docs/protocol.md, section 5). So only
    people who crowd others reach a limit.
    """
    pixels = sum(view.width * view.height for view in views)
    share = (_ONE_PERSON if each else 1.0) * max_cost * pixels / _FULL_SHARE_PIXELS
    return max(share, float(_MIN_SPLAT_PIXELS * len(views) * splats))


class PictureBudget:
    """Limits of one picture. Costs are in covered pixels (``renderer.Prepared.cost``)."""

    def __init__(
        self,
        max_cost: float = math.inf,  # a picture above it is refused before anything is drawn
        seconds: float = math.inf,  # from now on; a slower picture is abandoned between two slices
        slice_cost: float = math.inf,  # a picture above it is drawn in slices of about that cost
        abandoned: Callable[[], bool] = lambda: False,  # called between slices: whether the picture is not needed
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._max_cost, self._seconds, self._slice_cost = max_cost, seconds, slice_cost
        self._abandoned, self._clock = abandoned, clock
        self._start = clock()

    def render(self, prepared: Prepared, out: Images | None = None, transfer: Transfer | None = None) -> Images:
        """Render within these limits. Raises BudgetError (too_costly, abandoned, too_slow)."""
        if prepared.cost > self._max_cost:
            raise BudgetError(
                f"the picture covers {prepared.cost:.3g} pixels splat by splat, at most {self._max_cost:.3g} are drawn;"
                " ask for a smaller size or look from further away",
                "too_costly",
            )
        return prepared.render(between=self.check, slice_cost=self._slice_cost, out=out, transfer=transfer)

    def check(self) -> None:
        """Raise BudgetError (abandoned, too_slow) unless the picture is to be continued."""
        if self._abandoned():
            raise BudgetError("the picture is no longer wanted", "abandoned")
        if self._clock() - self._start > self._seconds:
            raise BudgetError(
                f"the picture took more than {self._seconds:g} s; ask for a smaller size or look from further away",
                "too_slow",
            )
