"""Sitting users: keep a low pelvis where it came to rest, or below a head that stays at sitting height."""

from __future__ import annotations

from math import exp, hypot

from glsplat.extras.learned.velocity import Velocity
from glsplat.tracking.solve.body import HEAD, PELVIS, Body, levelled
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    add,
    clamp,
    length,
    pull,
    rotate,
    smoothstep,
    sub,
    swing_twist_y,
    wrap,
    yaw_quat,
)

# of the pelvis' height at rest
SITS_BELOW, STANDS_ABOVE, LIES_BELOW = 0.74, 0.84, 0.2
LEFT_SEAT = 0.16  # distance at which a pelvis has left its seat
CALM_SPEED, CALM_S = 0.16, 0.7  # a low pelvis slower than that (m/s) for that long sits
PELVIS_SPEED_SMOOTHING_S = 0.1
WEIGHT_S = 0.4  # duration of the transition to and from sitting
SEAT_SMOOTHING_S, CHAIR_SMOOTHING_S = 1.5, 4.0  # of the seat's position, and of the chair that it follows
# of the eye height: range of a user upright on a chair; wider range in which they stay on it
CHAIR_EYES, LEFT_CHAIR_EYES = (0.68, 0.82), (0.6, 0.86)
STEADY_EYES_M, OVER_CHAIR_S = 0.08, 2.5  # radius and time of eyes over a chair, longer than a crouch is held
EYES_SMOOTHING_S, YAW_SMOOTHING_S = 1.0, 2.0
MAX_LEAN_M = 0.45  # largest horizontal distance of the eyes from the chair


class Seat:
    """Detects whether the user sits, and where. Positions are in the world, over the ground."""

    def __init__(self, body: Body) -> None:
        self.size: float = body.joints[PELVIS][1] - body.ground
        self.eye_height: float = body.eye_height
        x, y, z = body.joints[PELVIS]
        self.below: Vec = (x, y - body.ground - body.eye_height, z - body.joints[HEAD][2] - body.eye[2])  # the eyes
        self._velocity = Velocity(PELVIS_SPEED_SMOOTHING_S)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self.sits = False
        self.yaw = 0.0  # of the head, smoothed
        self._velocity.reset()
        self._share = 0.0  # weight of sitting, before easing
        self._seat: Vec = (0.0, 0.0, 0.0)  # position of the seated pelvis
        self._calm_s = 0.0
        self._eyes: Vec | None = None  # levelled and smoothed
        self._over_chair_s = 0.0  # time for which they have stayed at sitting height
        self._chair: Vec | None = None  # the pelvis' position by the eyes

    @property
    def share(self) -> float:
        """Weight of sitting: 0 .. 1, smooth in time."""
        return smoothstep(self._share)

    def update(self, pelvis: Vec, eye: Vec, head: Quat, dt: float) -> Vec | None:
        """Return the position of a seated pelvis, estimated at ``pelvis``; None if the user does not sit."""
        chair = self._over_chair(levelled(eye, head), swing_twist_y(head), dt)
        velocity = self._velocity.update(pelvis, dt)
        height = pelvis[1] / self.size
        if chair is not None:
            self._sit(chair)
        elif self.sits:
            away = hypot(pelvis[0] - self._seat[0], pelvis[2] - self._seat[2]) / self.size
            self.sits = LIES_BELOW < height < STANDS_ABOVE and away < LEFT_SEAT
        else:
            calm = LIES_BELOW < height < SITS_BELOW and length(velocity) < CALM_SPEED
            self._calm_s = self._calm_s + dt if calm else 0.0
            if self._calm_s > CALM_S:
                self._sit(pelvis)
        self._share = clamp(float(self.sits), self._share - dt / WEIGHT_S, self._share + dt / WEIGHT_S)
        if self._share <= 0:
            return None
        self._seat = pull(self._seat, chair or pelvis, 1 - exp(-dt / SEAT_SMOOTHING_S))
        return pull(pelvis, self._seat, self.share)

    def _sit(self, seat: Vec) -> None:
        self.sits, self._calm_s = True, 0.0
        self._seat = seat if self._share <= 0 else self._seat

    def _over_chair(self, eye: Vec, yaw: float | None, dt: float) -> Vec | None:
        """Return the pelvis of a user upright on a chair, from the eyes; None if they are not over a chair."""
        if self._eyes is None:
            self._eyes, self.yaw = eye, yaw or 0.0
        self._eyes = pull(self._eyes, eye, 1 - exp(-dt / EYES_SMOOTHING_S))
        turn = wrap((self.yaw if yaw is None else yaw) - self.yaw)
        self.yaw = wrap(self.yaw + turn * (1 - exp(-dt / YAW_SMOOTHING_S)))
        low, high = (share * self.eye_height for share in (CHAIR_EYES if self._chair is None else LEFT_CHAIR_EYES))
        if self._chair is None:
            stays = low < eye[1] < high and length(sub(eye, self._eyes)) < STEADY_EYES_M
            self._over_chair_s = self._over_chair_s + dt if stays else 0.0
            if self._over_chair_s < OVER_CHAIR_S:
                return None
            self._over_chair_s = 0.0
        elif not (low < eye[1] < high and hypot(eye[0] - self._chair[0], eye[2] - self._chair[2]) < MAX_LEAN_M):
            self._chair = None
            return None
        upright = add(self._eyes, rotate(yaw_quat(self.yaw), self.below))
        self._chair = pull(self._chair or upright, upright, 1 - exp(-dt / CHAIR_SMOOTHING_S))
        return self._chair
