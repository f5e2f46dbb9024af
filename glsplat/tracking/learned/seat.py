"""Who sits stays seated: the pelvis rests where it came to rest, whatever the head does above it."""

from __future__ import annotations

from math import exp, hypot

from glsplat.tracking.solve.quat import Vec, clamp, length, pull, scale, sub

__all__ = ["Seat"]

HIGH = (0.74, 0.84)  # of the pelvis' height at rest: it sits below, it has got up above
LOW = 0.2  # likewise: lower, it is on the ground
CALM, AFTER = 0.16, 0.7  # m/s below which, and seconds after which, a low pelvis sits
AWAY = 0.16  # of the pelvis' height at rest: a pelvis said to be further off than that is no longer there
TAKES = 0.4  # seconds in which it comes to rest, and gets going
SETTLES = 1.5  # seconds: of the low pass by which the seat's place is known better
SMOOTH = 0.1  # seconds, of the pelvis' speed


class Seat:
    """Whether somebody sits, and where. Places are in the world, over the ground."""

    def __init__(self, pelvis_height: float) -> None:
        self.size = pelvis_height
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.sits = False
        self._share = 0.0
        self._place: Vec = (0.0, 0.0, 0.0)
        self._before: Vec | None = None
        self._speed: Vec = (0.0, 0.0, 0.0)  # m/s
        self._calm = 0.0

    @property
    def share(self) -> float:
        """How much of somebody sits: 0 .. 1, smooth in time."""
        return self._share * self._share * (3 - 2 * self._share)

    def update(self, pelvis: Vec, dt: float) -> Vec | None:
        """Where the pelvis is that would else be at ``pelvis``; None: there."""
        if self._before is not None and dt > 0:
            self._speed = pull(self._speed, scale(sub(pelvis, self._before), 1 / dt), 1 - exp(-dt / SMOOTH))
        self._before = pelvis
        height = pelvis[1] / self.size
        if self.sits:
            away = hypot(pelvis[0] - self._place[0], pelvis[2] - self._place[2]) / self.size
            self.sits = LOW < height < HIGH[1] and away < AWAY
        else:
            calm = LOW < height < HIGH[0] and length(self._speed) < CALM
            self._calm = self._calm + dt if calm else 0.0
            if self._calm > AFTER:
                self.sits, self._calm = True, 0.0
                self._place = pelvis if self._share <= 0 else self._place
        goal = float(self.sits)
        self._share = clamp(goal, self._share - dt / TAKES, self._share + dt / TAKES)
        if self._share <= 0:
            return None
        self._place = pull(self._place, pelvis, 1 - exp(-dt / SETTLES))
        return pull(pelvis, self._place, self.share)
