"""How far a body is from losing the ground, and how far off it is."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin

from glsplat.tracking.solve.quat import Vec
from glsplat.tracking.solve.stepping.leg import TIPTOE, Leg
from glsplat.tracking.solve.tracked import AFLOAT, Follow

__all__ = ["TAKE_OFF", "Clearance"]

TAKE_OFF = 0.02  # metres below and above the reach of the tiptoes over which a jump begins


class Clearance:
    """Of two legs alike, over flat ground at y = 0."""

    def __init__(self, leg: Leg, sole: float) -> None:
        _, up, back = leg.ankle
        self.tiptoe: float = up * cos(TIPTOE) - back * sin(TIPTOE) - up  # metres the ankle rises on tiptoe
        self.farthest: float = leg.limb.farthest + up + self.tiptoe + sole  # of a hip from the ground

    def of(self, hips: Sequence[Vec], follow: Sequence[Follow]) -> tuple[float, float]:
        """Metres left until the tiptoes lose the ground, and metres both feet are off it."""
        left, right = (foot.height for foot in follow)
        reach = min(hips[0][1] - left, hips[1][1] - right) - self.farthest
        if all(foot.ankle is not None for foot in follow):
            return -reach, max(min(left, right) - AFLOAT, 0.0)
        # half a parabola from before the tiptoes lose the ground: the feet leave it without a jolt
        air = 0.0 if reach < -TAKE_OFF else max(reach, (min(reach, TAKE_OFF) + TAKE_OFF) ** 2 / (4 * TAKE_OFF))
        return -reach, air
