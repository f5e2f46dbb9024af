"""Smoothed velocities, and positions smoothed without lag in steady motion."""

from __future__ import annotations

from math import exp

from glsplat.tracking.solve.quat import Vec, add, pull, scale, sub

POSITION_SMOOTHING_S = (0.022, 0.022)  # of two successive low passes
LAG_SMOOTHING_S = 0.12  # of the velocity that compensates their lag


class Velocity:
    """Velocity of a point, m/s, after a low pass of ``smoothing`` seconds; zero at first."""

    def __init__(self, smoothing: float) -> None:
        self.smoothing = smoothing
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self.value: Vec = (0.0, 0.0, 0.0)
        self._last: Vec | None = None

    def update(self, position: Vec, dt: float, least: float = 0.0) -> Vec:
        """Return the velocity at a position; ``least``: the smallest weight of the newest step."""
        if self._last is not None:
            k = max(1 - exp(-dt / self.smoothing), least)
            self.value = pull(self.value, scale(sub(position, self._last), 1 / dt), k)
        self._last = position
        return self.value


class SteadyPosition:
    """Low passes of a position in the world, extrapolated by their lag at its recent velocity."""

    def __init__(self) -> None:
        self._velocity = Velocity(LAG_SMOOTHING_S)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self._velocity.reset()
        self._stages: list[Vec] = []

    def update(self, position: Vec, dt: float) -> Vec:
        """Return the smoothed position."""
        velocity = self._velocity.update(position, dt)
        self._stages = self._stages or [position] * len(POSITION_SMOOTHING_S)
        lag = 0.0
        for i, seconds in enumerate(POSITION_SMOOTHING_S):
            k = 1 - exp(-dt / seconds)
            self._stages[i] = position = pull(self._stages[i], position, k)
            lag += dt * (1 - k) / k  # of a low pass in steps, for a steady motion
        return add(position, scale(velocity, lag))
