"""Smooth a position without lag in steady motion."""

from __future__ import annotations

from math import exp

from glsplat.tracking.solve.quat import Vec, add, pull, scale, sub

__all__ = ["Steady"]

CALM = (0.022, 0.022)  # seconds of the low passes, one after the other
PACE = 0.12  # seconds: of the low pass of the speed by which their lag is made up for


class Steady:
    """Low passes of a position in the world, extrapolated by their lag at its recent velocity."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._before: Vec | None = None
        self._speed: Vec = (0.0, 0.0, 0.0)
        self._stages: list[Vec] = []

    def update(self, place: Vec, dt: float) -> Vec:
        """Return the smoothed position."""
        if self._before is None:
            self._before, self._stages = place, [place] * len(CALM)
        self._speed = pull(self._speed, scale(sub(place, self._before), 1 / dt), 1 - exp(-dt / PACE))
        self._before = place
        lag = 0.0
        for i, seconds in enumerate(CALM):
            k = 1 - exp(-dt / seconds)
            self._stages[i] = place = pull(self._stages[i], place, k)
            lag += dt * (1 - k) / k  # of a low pass in steps behind what moves steadily
        return add(place, scale(self._speed, lag))
