"""Detect sitting and standing users by head and pelvis, and place pelvis and feet; smoothed velocities."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot

from glsplat.extras.learned.hints import FootHint
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import HEAD, PELVIS, Body, levelled
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, length, pull, rotate, scale, sub, wrap
from glsplat.tracking.solve.solution import Targets

POSITION_SMOOTHING_S = (0.022, 0.022)  # of two successive low passes
LAG_SMOOTHING_S = 0.12  # of the velocity that compensates their lag

# lengths and speeds are those of eyes at 1.6 m
REST_RADIUS_M, REST_TURN_RAD, REST_S = 0.04, 0.3, 0.4  # range and time of a head that takes no step
DRIFT_SMOOTHING_S = 0.4  # of the head's velocity: sway and gestures average out
STANDING_SPEED, MOVING_SPEED = 0.08, 0.3  # m/s of that: standing below, not standing above
LOW_EYES, HIGH_EYES = 0.82, 0.9  # of the eye height: squatting or sitting below, standing above
NETWORK_SHARE = 0.5  # of a standing foot's position; the rest is the median of all three estimates
HOME_ASIDE_M, HOME_BEHIND_M = 0.17, 0.14  # from the eyes to the balls of standing feet (median of captured motion)
STANDING_SMOOTHING_S, MOVING_SMOOTHING_S = 0.6, 0.02  # of the positions of head and feet
KNEE_SHARE = 0.5  # of a foot's shift by which its knee moves

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


class HeadRest:
    """Detects a resting head, which stays in a small ball and hardly turns for a while."""

    def __init__(self, size: float) -> None:
        self.size = size
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self._at: Vec | None = None
        self._yaw = self._rest_s = 0.0

    def update(self, eye: Vec, yaw: float, dt: float) -> bool:
        """Return whether the head rests now."""
        near = self._at is not None and length(sub(eye, self._at)) <= REST_RADIUS_M * self.size
        if not near or abs(wrap(yaw - self._yaw)) > REST_TURN_RAD:
            self._at, self._yaw, self._rest_s = eye, yaw, 0.0
        self._rest_s += dt
        return self._rest_s > REST_S


class Stance:
    """Positions of standing feet from three estimates: half way between the network's and the median.

    The median rejects a single outlier. Standing feet do not move, so recent estimates are averaged.
    """

    def __init__(self, body: Body) -> None:
        self.eye_height: float = body.eye_height
        self.size: float = body.eye_height / 1.6
        aside, behind = HOME_ASIDE_M * self.size, HOME_BEHIND_M * self.size
        self.home: tuple[Vec, Vec] = ((aside, 0.0, -behind), (-aside, 0.0, -behind))
        self._velocity = Velocity(DRIFT_SMOOTHING_S)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self.share: float = 1.0  # weight of standing: 0 .. 1
        self._velocity.reset()
        self._head: Vec | None = None  # smoothed position of the eyes
        self._yaw = 0.0  # of the head, likewise
        self._elapsed_s = 0.0
        self._places: list[Vec] = []

    def update(self, targets: Targets, hints: Sequence[FootHint], analytic: Sequence[Foot], dt: float) -> float:
        """Move the hints to the standing feet by the weight of standing; return that weight."""
        eye, yaw = targets.eye, quat.swing_twist_y(targets.head)
        if self._head is None:
            self._head, self._yaw = eye, yaw or 0.0
        self._elapsed_s += dt
        least = dt / self._elapsed_s  # the first velocities count at once, for a start in mid-walk
        drift_x, _, drift_z = self._velocity.update(eye, dt, least)
        drift = hypot(drift_x, drift_z) / self.size
        tall = clamp((eye[1] / self.eye_height - LOW_EYES) / (HIGH_EYES - LOW_EYES), 0.0, 1.0)
        slow = clamp((MOVING_SPEED - drift) / (MOVING_SPEED - STANDING_SPEED), 0.0, 1.0)
        self.share = share = tall * slow
        k = max(1 - exp(-dt / (MOVING_SMOOTHING_S + STANDING_SMOOTHING_S * share)), least)
        self._head = pull(self._head, eye, k)
        self._yaw = wrap(self._yaw + wrap((self._yaw if yaw is None else yaw) - self._yaw) * k)
        sides = enumerate(zip(hints, analytic, strict=True))
        places = [self._combined(side, hint.ball, foot.ball, self._head) for side, (hint, foot) in sides]
        self._places = [pull(a, b, k) for a, b in zip(self._places or places, places, strict=True)]
        for hint, place in zip(hints, self._places, strict=True):
            x, z = share * (place[0] - hint.ball[0]), share * (place[2] - hint.ball[2])
            hint.ball = add(hint.ball, (x, 0.0, z))
            hint.knee = add(hint.knee, (KNEE_SHARE * x, 0.0, KNEE_SHARE * z))
        return share

    def _combined(self, side: int, ball: Vec, analytic: Vec, head: Vec) -> Vec:
        """Return a foot's position from the network's ``ball``, the ``analytic`` one and the rest pose."""
        x, _, z = add(head, rotate(quat.yaw_quat(self._yaw), self.home[side]))
        median = (sorted((x, ball[0], analytic[0]))[1], ball[1], sorted((z, ball[2], analytic[2]))[1])
        return pull(median, ball, NETWORK_SHARE)


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
        return quat.smoothstep(self._share)

    def update(self, pelvis: Vec, eye: Vec, head: Quat, dt: float) -> Vec | None:
        """Return the position of a seated pelvis, estimated at ``pelvis``; None if the user does not sit."""
        chair = self._over_chair(levelled(eye, head), quat.swing_twist_y(head), dt)
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
        upright = add(self._eyes, rotate(quat.yaw_quat(self.yaw), self.below))
        self._chair = pull(self._chair or upright, upright, 1 - exp(-dt / CHAIR_SMOOTHING_S))
        return self._chair
