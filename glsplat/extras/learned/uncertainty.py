"""Detect poses outside the network's training: heads near the ground, upside down or on their side, hands out of reach
of the guessed chest.
"""

from __future__ import annotations

from glsplat.tracking.solve.quat import clamp, rotate
from glsplat.tracking.solve.solution import Targets

__all__ = ["Uncertainty"]

TILTED = (0.3, 0.5)  # vertical part of the head's own up: below, it lies or hangs; above, it is upright again
LOW = (0.62, 0.68)  # of the eye height, likewise: a deep squat, on all fours, on the floor
MISSED = (0.06, 0.03)  # metres (of eyes at 1.6 m) an arm misses its hand by, likewise
AFTER = (0.2, 1.0)  # seconds of that after which it is not asked, and is asked again
TURN = 0.35  # seconds in which one takes over from the other


class Uncertainty:
    """Share of the analytic solver in the torso: 0 none, 1 all of it. Smooth in time."""

    def __init__(self, eye_height: float) -> None:
        self.size: float = eye_height / 1.6
        self.low: tuple[float, float] = (LOW[0] * eye_height, LOW[1] * eye_height)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.doubts: bool = False
        self._at: float | None = None
        self._misses = False
        self._since = 0.0  # seconds for which that has been otherwise

    def update(self, targets: Targets, missed: float, dt: float) -> float:
        """Return the share of this moment. ``missed``: metres by which the worse arm missed its hand a moment ago."""
        up = rotate(targets.head, (0.0, 1.0, 0.0))[1]
        side = int(self._misses)
        self._since = self._since + dt if (missed > MISSED[side] * self.size) != self._misses else 0.0
        if self._since > AFTER[side]:
            self._misses, self._since = not self._misses, 0.0
        side = int(self.doubts)
        self.doubts = up < TILTED[side] or targets.eye[1] < self.low[side] or self._misses
        goal = float(self.doubts)
        if self._at is None:
            self._at = goal
        self._at = clamp(goal, self._at - dt / TURN, self._at + dt / TURN)
        return self._at * self._at * (3 - 2 * self._at)
