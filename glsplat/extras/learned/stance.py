"""Detect standing users by the head alone; combine their feet from network, balance and rest pose."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot

from glsplat.extras.learned.hints import FootHint
from glsplat.extras.learned.velocity import Velocity
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.quat import Vec, add, clamp, length, pull, rotate, sub, swing_twist_y, wrap, yaw_quat
from glsplat.tracking.solve.solution import Targets

# lengths and speeds are those of eyes at 1.6 m
REST_RADIUS_M, REST_TURN_RAD, REST_S = 0.04, 0.3, 0.4  # range and time of a head that takes no step
DRIFT_SMOOTHING_S = 0.4  # of the head's velocity: sway and gestures average out
STANDING_SPEED, MOVING_SPEED = 0.08, 0.3  # m/s of that: standing below, not standing above
LOW_EYES, HIGH_EYES = 0.82, 0.9  # of the eye height: squatting or sitting below, standing above
NETWORK_SHARE = 0.5  # of a standing foot's position; the rest is the median of all three estimates
HOME_ASIDE_M, HOME_BEHIND_M = 0.17, 0.14  # from the eyes to the balls of standing feet (median of captured motion)
STANDING_SMOOTHING_S, MOVING_SMOOTHING_S = 0.6, 0.02  # of the positions of head and feet
KNEE_SHARE = 0.5  # of a foot's shift by which its knee moves


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
        eye, yaw = targets.eye, swing_twist_y(targets.head)
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
        x, _, z = add(head, rotate(yaw_quat(self._yaw), self.home[side]))
        median = (sorted((x, ball[0], analytic[0]))[1], ball[1], sorted((z, ball[2], analytic[2]))[1])
        return pull(median, ball, NETWORK_SHARE)
