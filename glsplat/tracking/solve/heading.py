"""Heading: which way the body faces, following head, hands and walking direction sensibly."""

from __future__ import annotations

from math import atan2, exp, hypot, pi

from glsplat.tracking.solve.quat import Quat, Vec, clamp, rotate, swing_twist_y, wrap

__all__ = ["Heading"]

COMFORT = 0.4  # rad: the head turns this far without the body following soon
LARGEST = 1.1  # rad: the body is never left further behind (cervical + thoracic rotation, AAOS: 60 + 45 degrees)
WIDEST = 1.5  # rad: likewise, of a body whose pelvis is tracked
SLOW = 0.8  # of a turned head that the body follows in a second, inside the comfort zone
SWAYED = 0.15  # of the yaw that both hands suggest which the body takes
TURN_RATE = 9.0  # rad/s at most


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
        """New yaw from the head joint's world rotation, tracked wrists and the walking velocity (m/s).

        ``tracked``: yaw of a tracked pelvis, and the part of the way to it that is taken now, 0 to 1.
        """
        seen = swing_twist_y(head)
        if seen is not None:
            self.head_yaw = seen
        if not self.started:
            self.yaw, self.hands, self.started = self.head_yaw if tracked is None else tracked[0], 0.0, True
            return self.yaw
        error = wrap(self.head_yaw - self.yaw)
        walking = clamp((speed - 0.3) / 0.5, 0.0, 1.0)
        off = abs(error)
        # standing: slow inside the comfort zone, quick far outside; walking: the body goes where the head goes
        urge = clamp((off - COMFORT) / 0.8, 0.0, 1.0)
        rate = SLOW + 4.0 * urge * urge + 3.5 * walking
        target = error
        self._hands(eye, left, right, dt)
        target += SWAYED * self.hands * (1 - 0.6 * walking)
        if speed > 0.5 and walking > 0:
            # walking forward pulls towards the direction of travel; sideways and backward walking do not
            travel = wrap(atan2(velocity[0], velocity[2]) - self.yaw)
            if abs(travel) < 0.9:
                target += 0.3 * walking * clamp(travel - target, -0.5, 0.5)
        step = target * (1 - exp(-rate * dt))
        self.yaw = wrap(self.yaw + clamp(step, -TURN_RATE * dt, TURN_RATE * dt))
        largest = LARGEST
        if tracked is not None:
            step = wrap(tracked[0] - self.yaw) * tracked[1]
            self.yaw = wrap(self.yaw + clamp(step, -2 * TURN_RATE * dt, 2 * TURN_RATE * dt))
            largest = WIDEST
        left_behind = wrap(self.head_yaw - self.yaw)
        if abs(left_behind) > largest and seen is not None:
            excess = left_behind - largest if left_behind > 0 else left_behind + largest
            self.yaw = wrap(self.yaw + clamp(excess, -2 * TURN_RATE * dt, 2 * TURN_RATE * dt))
        return self.yaw

    def _hands(self, eye: Vec, left: Vec | None, right: Vec | None, dt: float) -> None:
        """The yaw that both hands suggest, from the head's: across the line between them, and towards them."""
        wanted = 0.0
        if left is not None and right is not None:
            ax, az = left[0] - right[0], left[2] - right[2]  # +x of the body
            bx, bz = 0.5 * (left[0] + right[0]) - eye[0], 0.5 * (left[2] + right[2]) - eye[2]
            fx, fz = -az + 0.5 * bx, ax + 0.5 * bz
            far = hypot(fx, fz)
            if far > 0.1:
                angle = wrap(atan2(fx, fz) - self.head_yaw)
                # hands crossed or behind the back say nothing
                sure = clamp((far - 0.1) / 0.4, 0.0, 1.0) * clamp((2.2 - abs(angle)) / 0.8, 0.0, 1.0)
                wanted = sure * clamp(angle, -1.2, 1.2)
        self.hands += (wanted - self.hands) * (1 - exp(-dt / 0.1))


def head_pitch(head: Quat, yaw: float) -> float:
    """How far the head looks down (radians, positive down), -pi/2 .. pi/2."""
    forward = rotate(head, (0.0, 0.0, 1.0))
    return clamp(atan2(-forward[1], hypot(forward[0], forward[2])), -pi / 2, pi / 2)


def head_roll(head: Quat) -> float:
    """How far the head tilts to its left (radians), -pi/2 .. pi/2; 0 for a head that looks straight up or down."""
    left = rotate(head, (1.0, 0.0, 0.0))
    up = rotate(head, (0.0, 1.0, 0.0))
    return clamp(atan2(-left[1], hypot(left[0], left[2])), -pi / 2, pi / 2) * clamp(2.5 * up[1] - 1.25, 0.0, 1.0)
