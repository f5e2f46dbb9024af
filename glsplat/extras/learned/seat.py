"""Sitting users: the pelvis rests where it came to rest, or below a head that stays at the height over a chair."""

from __future__ import annotations

from math import exp, hypot

from glsplat.tracking.solve.body import HEAD, PELVIS, Body, levelled
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    add,
    clamp,
    length,
    pull,
    rotate,
    scale,
    sub,
    swing_twist_y,
    wrap,
    yaw_quat,
)

__all__ = ["Seat"]

HIGH = (0.74, 0.84)  # of the pelvis' height at rest: it sits below, it has got up above
LOW = 0.2  # likewise: lower, it is on the ground
CALM, AFTER = 0.16, 0.7  # m/s below which, and seconds after which, a low pelvis sits
AWAY = 0.16  # of the pelvis' height at rest: a pelvis said to be further off than that is no longer there
TAKES = 0.4  # seconds in which it comes to rest, and gets going
SETTLES = 1.5  # seconds: of the low pass by which the seat's place is known better
SMOOTH = 0.1  # seconds, of the pelvis' speed
CHAIR, LEFT = (0.68, 0.82), (0.6, 0.86)  # of the eye height: eyes of who sits upright; lower or higher, they get up
STEADY, LONG = 0.08, 2.5  # metres that such eyes keep to, for so many seconds: a crouch is not held that long
LATELY, TURNS, LEANS = 1.0, 2.0, 0.45  # seconds: means of the head's place and heading; metres it leans aside at most
CHANGES = 4.0  # seconds: of the low pass by which a chair moves along


class Seat:
    """Detect whether the user sits, and where. Positions are in the world, over the ground."""

    def __init__(self, body: Body) -> None:
        self.size: float = body.joints[PELVIS][1] - body.ground
        self.eye_height: float = body.eye_height
        x, y, z = body.joints[PELVIS]
        self.below: Vec = (x, y - body.ground - body.eye_height, z - body.joints[HEAD][2] - body.eye[2])  # the eyes
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.sits = False
        self._share = 0.0
        self._place: Vec = (0.0, 0.0, 0.0)
        self._before: Vec | None = None
        self._speed: Vec = (0.0, 0.0, 0.0)  # m/s
        self._calm = 0.0
        self._lately: Vec | None = None  # of the level eyes
        self.yaw = 0.0  # of the head, likewise
        self._for = 0.0  # seconds for which they have kept as high as over a chair
        self._chair: Vec | None = None  # where the pelvis is by that

    @property
    def share(self) -> float:
        """Weight of sitting: 0 .. 1, smooth in time."""
        return self._share * self._share * (3 - 2 * self._share)

    def update(self, pelvis: Vec, eye: Vec, head: Quat, dt: float) -> Vec | None:
        """Return the position of a seated pelvis, guessed at ``pelvis``; None where the user does not sit."""
        chair = self._over_a_chair(levelled(eye, head), swing_twist_y(head), dt)
        if self._before is not None and dt > 0:
            self._speed = pull(self._speed, scale(sub(pelvis, self._before), 1 / dt), 1 - exp(-dt / SMOOTH))
        self._before = pelvis
        height = pelvis[1] / self.size
        if chair is not None:
            self._place = chair if self._share <= 0 else self._place
            self.sits, self._calm = True, 0.0
        elif self.sits:
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
        self._place = pull(self._place, chair or pelvis, 1 - exp(-dt / SETTLES))
        return pull(pelvis, self._place, self.share)

    def _over_a_chair(self, eye: Vec, yaw: float | None, dt: float) -> Vec | None:
        """Return the pelvis of a user upright on a chair, from the eyes; None where they are not over a chair."""
        if self._lately is None:
            self._lately, self.yaw = eye, yaw or 0.0
        self._lately = pull(self._lately, eye, 1 - exp(-dt / LATELY))
        self.yaw = wrap(self.yaw + wrap((self.yaw if yaw is None else yaw) - self.yaw) * (1 - exp(-dt / TURNS)))
        low, high = (share * self.eye_height for share in (CHAIR if self._chair is None else LEFT))
        if self._chair is None:
            keeps = low < eye[1] < high and length(sub(eye, self._lately)) < STEADY
            self._for = self._for + dt if keeps else 0.0
            if self._for < LONG:
                return None
            self._for = 0.0
        elif not (low < eye[1] < high and hypot(eye[0] - self._chair[0], eye[2] - self._chair[2]) < LEANS):
            self._chair = None
            return None
        upright = add(self._lately, rotate(yaw_quat(self.yaw), self.below))
        self._chair = upright if self._chair is None else pull(self._chair, upright, 1 - exp(-dt / CHANGES))
        return self._chair
