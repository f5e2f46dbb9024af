"""What happens to a head that is higher than the body can bring it, or in the floor."""

from __future__ import annotations

from dataclasses import replace
from math import exp

from glsplat.tracking.solve.solution import Targets

__all__ = ["Ground"]

LONGEST_JUMP = 0.7  # seconds; a head out of reach for longer is not a jump (0.7 s in the air is a leap of 0.6 m)
LOWEST_EYE = 0.04  # of the eye height: a head on the floor
SINKS = 0.25  # seconds
TOLD = 0.02  # metres


class Ground:
    """The head within the body's reach: above the floor, and not higher than the legs allow for longer than a jump.

    A user taller than the avatar, or a head that looks straight down without bending, would else float for ever.
    """

    def __init__(self, eye_height: float) -> None:
        self.lowest: float = LOWEST_EYE * eye_height
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._flight = 0.0  # seconds in the air
        self._sink = 0.0  # metres the body stays below a head that is out of reach

    @property
    def notes(self) -> list[str]:
        """What to say of it."""
        return ["head_out_of_reach"] if self._sink > TOLD else []

    def bring(self, targets: Targets, slack: float, tiptoe: float, dt: float) -> Targets:
        """Targets that can be met. ``slack``: metres that were left a moment ago until the tiptoes lost the ground;
        ``tiptoe``: metres that an ankle rises on them.
        """
        self._flight = self._flight + dt if slack < 0 else 0.0
        if self._flight > LONGEST_JUMP or self._sink > 0:
            # down to flat feet, and up again with the head
            self._sink = max(0.0, self._sink - (slack - tiptoe) * (1 - exp(-dt / SINKS)))
        x, y, z = targets.eye
        sunk = max(y - self._sink, self.lowest)
        return targets if sunk == y else replace(targets, eye=(x, sunk, z))
