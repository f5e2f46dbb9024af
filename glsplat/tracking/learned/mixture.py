"""How much of the body is the analytic solver's: by what either is expected to be off, smooth in time.

The network says at every moment what both are off (``training/doubting.py``). The best mean of two guesses weighs them
by their precisions, and the better one more the more their errors have in common (Bates & Granger 1969).
"""

from __future__ import annotations

from math import exp

from glsplat.tracking.learned.hints import Off
from glsplat.tracking.solve.quat import clamp

__all__ = ["Mixture"]

UNSEEN = (1.2, 1.3, 1.3)  # times further off than it says is the network for people it has not seen: pelvis, feet
ALIKE = 0.5  # correlation of their errors
FOLLOWS = 0.25  # seconds: of either low pass of a share


class Mixture:
    """The analytic solver's shares of the pelvis and of either foot's goal, 0 .. 1."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._stages: list[list[float]] = []

    def update(self, off: Off, dt: float) -> list[float]:
        """Of this moment: pelvis, left, right foot."""
        now = []
        for mine, its, unseen in zip(*off, UNSEEN, strict=True):
            network, analytic = unseen * mine, its
            common = ALIKE * network * analytic
            least = network * network + analytic * analytic - 2 * common
            now.append(clamp((network * network - common) / least, 0.0, 1.0))
        if not self._stages:
            self._stages = [now, now]
        k = 1 - exp(-dt / FOLLOWS)
        for i, stage in enumerate(self._stages):
            self._stages[i] = now = [s + (n - s) * k for s, n in zip(stage, now, strict=True)]
        return now
