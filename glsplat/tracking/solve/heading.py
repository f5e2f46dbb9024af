"""Heading: the direction a body faces, from head, hands and walking direction."""

from __future__ import annotations

from math import atan2, exp, hypot, pi

from glsplat.tracking.solve.quat import Quat, Vec, clamp, rotate, swing_twist_y, wrap

COMFORT_RAD = 0.4  # that a head turns without the body following soon
MAX_BEHIND_RAD = 1.1  # of the body behind the head (cervical + thoracic rotation, AAOS: 60 + 45 degrees)
MAX_TRACKED_BEHIND_RAD = 1.5  # likewise, of a body whose pelvis is tracked
SLOW_RATE = 0.8  # 1/s: of the body that follows a head inside the comfort zone
URGENT_RATE, WALKING_RATE = 4.0, 3.5  # 1/s: likewise, added far outside it, and while walking
HANDS_WEIGHT = 0.15  # of the yaw that both hands suggest
HANDS_SMOOTHING_S = 0.1
MAX_TURN_RATE = 9.0  # rad/s


class Heading:
    """The body's yaw. The zero pose faces +z at yaw 0."""

    def __init__(self) -> None:
        self.yaw: float = 0.0
        self.head_yaw: float = 0.0
        self.hands: float = 0.0  # radians from the head's yaw
        self.started: bool = False

    def reset(self) -> None:
        """Forget the past: the next update faces where the head faces."""
        self.started = False

    def update(
        self,
        head: Quat,
        eye: Vec,
        left: Vec | None,
        right: Vec | None,
        velocity: Vec,
        speed: float,
        dt: float,
        tracked: tuple[float, float] | None = None,
    ) -> float:
        """Return the yaw from the head joint's world rotation, tracked wrists and the walking velocity (m/s).

        ``tracked``: yaw of a tracked pelvis, and the part of the way to it that is taken now, 0 to 1.
        """
        head_yaw = swing_twist_y(head)
        if head_yaw is not None:
            self.head_yaw = head_yaw
        if not self.started:
            self.yaw, self.hands, self.started = self.head_yaw if tracked is None else tracked[0], 0.0, True
            return self.yaw
        error = wrap(self.head_yaw - self.yaw)
        walking = clamp((speed - 0.3) / 0.5, 0.0, 1.0)
        # standing: slow inside the comfort zone, quick far outside; walking: the body goes where the head goes
        urge = clamp((abs(error) - COMFORT_RAD) / 0.8, 0.0, 1.0)
        rate = SLOW_RATE + URGENT_RATE * urge * urge + WALKING_RATE * walking
        self._update_hands(eye, left, right, dt)
        target = error + HANDS_WEIGHT * self.hands * (1 - 0.6 * walking)
        if speed > 0.5 and walking > 0:
            # walking forward pulls towards the direction of travel; sideways and backward walking do not
            travel = wrap(atan2(velocity[0], velocity[2]) - self.yaw)
            if abs(travel) < 0.9:
                target += 0.3 * walking * clamp(travel - target, -0.5, 0.5)
        step = target * (1 - exp(-rate * dt))
        self.yaw = wrap(self.yaw + clamp(step, -MAX_TURN_RATE * dt, MAX_TURN_RATE * dt))
        max_behind = MAX_BEHIND_RAD
        if tracked is not None:
            step = wrap(tracked[0] - self.yaw) * tracked[1]
            self.yaw = wrap(self.yaw + clamp(step, -2 * MAX_TURN_RATE * dt, 2 * MAX_TURN_RATE * dt))
            max_behind = MAX_TRACKED_BEHIND_RAD
        behind = wrap(self.head_yaw - self.yaw)
        if abs(behind) > max_behind and head_yaw is not None:
            excess = behind - max_behind if behind > 0 else behind + max_behind
            self.yaw = wrap(self.yaw + clamp(excess, -2 * MAX_TURN_RATE * dt, 2 * MAX_TURN_RATE * dt))
        return self.yaw

    def _update_hands(self, eye: Vec, left: Vec | None, right: Vec | None, dt: float) -> None:
        """Update the yaw that both hands suggest, from the head's: across the line between them, and towards them."""
        wanted = 0.0
        if left is not None and right is not None:
            ax, az = left[0] - right[0], left[2] - right[2]  # +x of the body
            bx, bz = 0.5 * (left[0] + right[0]) - eye[0], 0.5 * (left[2] + right[2]) - eye[2]
            fx, fz = -az + 0.5 * bx, ax + 0.5 * bz
            far = hypot(fx, fz)
            if far > 0.1:
                angle = wrap(atan2(fx, fz) - self.head_yaw)
                # hands crossed or behind the back do not count
                sure = clamp((far - 0.1) / 0.4, 0.0, 1.0) * clamp((2.2 - abs(angle)) / 0.8, 0.0, 1.0)
                wanted = sure * clamp(angle, -1.2, 1.2)
        self.hands += (wanted - self.hands) * (1 - exp(-dt / HANDS_SMOOTHING_S))


def head_pitch(head: Quat) -> float:
    """Return how far the head looks down (radians, positive down), -pi/2 .. pi/2."""
    forward = rotate(head, (0.0, 0.0, 1.0))
    return clamp(atan2(-forward[1], hypot(forward[0], forward[2])), -pi / 2, pi / 2)


def head_roll(head: Quat) -> float:
    """Return how far the head tilts to its left (radians), -pi/2 .. pi/2; 0 for one that looks up or down."""
    left = rotate(head, (1.0, 0.0, 0.0))
    up = rotate(head, (0.0, 1.0, 0.0))
    return clamp(atan2(-left[1], hypot(left[0], left[2])), -pi / 2, pi / 2) * clamp(2.5 * up[1] - 1.25, 0.0, 1.0)
