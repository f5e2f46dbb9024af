"""One Euro filters for positions and rotations: steady when still, quick when moving; and bounded prediction.

Casiez, Roussel & Vogel, "1 Euro Filter: A Simple Speed-based Low-pass Filter for Noisy Input in Interactive Systems",
CHI 2012: a first-order low pass whose cutoff grows with the speed, fc = min_cutoff + beta |speed|. One speed serves all
coordinates, so the filter has no preferred axis. Here two equal low passes of twice that cutoff follow each other: the
same lag, but noise falls off with the square of its frequency, and it is the fast part of noise that shakes a body. Low
passes of first order cannot overshoot. Both together lag by 1 / (2 pi fc): at rest 1 / (2 pi min_cutoff) seconds; at
speed the distance behind is below 1 / (2 pi beta), whatever the speed.
"""

from __future__ import annotations

from collections import deque
from math import acos, exp, pi, sqrt
from typing import Generic, TypeVar

from glsplat.tracking.config import OneEuro, TrackerConfig
from glsplat.tracking.judge import Moment
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, add, clamp, length, mul, pull
from glsplat.tracking.solve.solution import Targets

Value = TypeVar("Value", bound=tuple[float, ...])


TREND_S = 0.1  # of the past that a prediction goes by: less trembles more, more comes later
MIN_TREND_POINTS, MIN_TREND_SHARE = 4, 0.7  # points, and the part of TREND_S that they cover
MAX_TREND_POINTS = 64  # no device is that quick, but a client may claim to be
NLERP_BELOW_RAD = 0.5  # a rotation that small is interpolated linearly


class Trend:
    """The velocity of the last ``TREND_S`` seconds: the slope of a line fitted by least squares.

    Steps faster than ``max_speed`` are cut to it: a device that is found elsewhere has not moved there.
    """

    def __init__(self, max_speed: float) -> None:
        self._past: deque[tuple[float, Vec]] = deque(maxlen=MAX_TREND_POINTS)  # seconds, the path until then
        self._max_speed, self._now = max_speed, 0.0
        self._path: Vec = (0.0, 0.0, 0.0)  # the sum of all steps

    def add(self, step: Vec, dt: float) -> None:
        """Add a move by ``step`` in ``dt`` seconds."""
        self._now += dt
        far, most = length(step), self._max_speed * dt
        self._path = add(self._path, step if far <= most else quat.scale(step, most / far))
        self._past.append((self._now, self._path))
        while self._now - self._past[0][0] > TREND_S:
            self._past.popleft()

    def velocity(self) -> Vec | None:
        """Return the velocity a second; None while too little of the past is known."""
        if len(self._past) < MIN_TREND_POINTS or self._now - self._past[0][0] < MIN_TREND_SHARE * TREND_S:
            return None
        middle = sum(t for t, _ in self._past) / len(self._past)
        spread = sum((t - middle) ** 2 for t, _ in self._past)
        x, y, z = (sum((t - middle) * at[k] for t, at in self._past) / spread for k in range(3))
        return (x, y, z)


class _Filter(Generic[Value]):
    """One Euro with a limit on the speed: the common part of positions and rotations."""

    def __init__(self, setting: OneEuro, max_speed: float) -> None:
        self.setting, self.max_speed = setting, max_speed
        self.first: Value | None = None  # behind the first low pass
        self.value: Value | None = None
        self.velocity: Vec = (0.0, 0.0, 0.0)
        self.trend: Trend | None = None  # kept once a prediction was asked for
        self._raw: Value | None = None

    def reset(self) -> None:
        """Forget the past: the next value passes unchanged."""
        self.first = self.value = self.trend = self._raw = None
        self.velocity = (0.0, 0.0, 0.0)

    def _share(self, x: float, y: float, z: float, dt: float) -> float:
        """Update the velocity by a move in dt seconds; return the fraction that each low pass goes to its input."""
        setting = self.setting
        a = 1 - exp(-2 * pi * setting.derivative_cutoff * dt)
        rate = 1 / dt
        vx, vy, vz = self.velocity
        vx, vy, vz = vx + (x * rate - vx) * a, vy + (y * rate - vy) * a, vz + (z * rate - vz) * a
        self.velocity = (vx, vy, vz)
        return setting.share(sqrt(vx * vx + vy * vy + vz * vz), dt)

    def _move(self, seconds: float, most: float) -> Vec:
        """Return the move of the next ``seconds`` at the present velocity, at most ``most`` long."""
        self.trend = self.trend or Trend(self.max_speed)
        vx, vy, vz = self.trend.velocity() or self.velocity
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        k = seconds if speed * seconds <= most else most / speed
        return (vx * k, vy * k, vz * k)


class PositionFilter(_Filter[Vec]):
    """One Euro on a point, with a limit on its speed."""

    def update(self, raw: Vec, dt: float) -> Vec:
        """Return the filtered point ``dt`` seconds after the last one."""
        last, value = self.first, self.value
        if self.trend is not None:
            self.trend.add(quat.sub(raw, self._raw or raw), dt)
            self._raw = raw
        if last is None or value is None:
            self.first = self.value = raw
            return raw
        dx, dy, dz = raw[0] - last[0], raw[1] - last[1], raw[2] - last[2]
        far = sqrt(dx * dx + dy * dy + dz * dz)
        most = self.max_speed * dt
        if far > most:
            k = most / far
            dx, dy, dz = dx * k, dy * k, dz * k
        k = self._share(dx, dy, dz, dt)
        self.first = first = (last[0] + dx * k, last[1] + dy * k, last[2] + dz * k)
        self.value = value = first if k == 1 else pull(value, first, k)
        return value

    def ahead(self, seconds: float, most: float) -> Vec:
        """Return the value extrapolated at its present velocity, by at most ``most`` metres."""
        return add(self.value or (0.0, 0.0, 0.0), self._move(seconds, most))


class RotationFilter(_Filter[Quat]):
    """One Euro on a unit quaternion, whichever its sign, with a limit on its speed; velocity in rad/s, world axes."""

    def update(self, raw: Quat, dt: float) -> Quat:
        """Return the filtered rotation ``dt`` seconds after the last one."""
        last, value = self.first, self.value
        if self.trend is not None:
            self.trend.add(quat.rotation_vector(mul(raw, quat.conj(self._raw or raw))), dt)
            self._raw = raw
        if last is None or value is None:
            self.first = self.value = raw
            return raw
        # the turn from the last value, world axes: raw conj(last)
        aw, ax, ay, az = raw
        bw, bx, by, bz = last
        w = aw * bw + ax * bx + ay * by + az * bz
        x = -aw * bx + ax * bw - ay * bz + az * by
        y = -aw * by + ax * bz + ay * bw - az * bx
        z = -aw * bz - ax * by + ay * bx + az * bw
        if w < 0:
            w, x, y, z = -w, -x, -y, -z
        n = sqrt(x * x + y * y + z * z)
        angle = 2 * acos(min(w, 1.0)) if n > 1e-9 else 0.0
        most = self.max_speed * dt
        k = (min(angle, most) / n) if n > 1e-9 else 0.0
        x, y, z = x * k, y * k, z * k  # rotation vector of the allowed turn
        share = self._share(x, y, z, dt)
        allowed = min(angle, most)
        k = (angle and allowed / angle) * share
        if angle < NLERP_BELOW_RAD:
            first = quat.nlerp(last, raw, k)
        else:  # the allowed turn, shortened to the part k of the whole turn
            f = clamp(k * angle / allowed, 0.0, 1.0) if allowed > 1e-12 else 0.0
            first = mul(quat.to_quat((x * f, y * f, z * f)), last)
        self.first = first
        self.value = value = first if share == 1 else quat.slerp(value, first, share)
        return value

    def ahead(self, seconds: float, most: float) -> Quat:
        """Return the value extrapolated at its present angular velocity, by at most ``most`` radians."""
        return mul(quat.to_quat(self._move(seconds, most)), self.value or quat.IDENTITY)


class DeviceFilter:
    """Filters of one tracked pose."""

    def __init__(self, position: OneEuro, rotation: OneEuro, max_speed: float, max_turn_speed: float) -> None:
        self.position = PositionFilter(position, max_speed)
        self.rotation = RotationFilter(rotation, max_turn_speed)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next pose passes unchanged."""
        self.position.reset()
        self.rotation.reset()
        self.pose: JointPose | None = None  # as filtered last

    def update(self, pose: JointPose, dt: float) -> JointPose:
        """Return the filtered pose ``dt`` seconds after the last one."""
        self.pose = self.position.update(pose[0], dt), self.rotation.update(pose[1], dt)
        return self.pose

    def ahead(self, seconds: float, config: TrackerConfig) -> JointPose:
        """Return the last pose extrapolated by ``seconds``, within the bounds of ``config``."""
        return (
            self.position.ahead(seconds, config.predicted_metres),
            self.rotation.ahead(seconds, config.predicted_radians),
        )


class HeadAndHandFilters:
    """The stage of a Tracker that filters and predicts head and hands."""

    def __init__(self, config: TrackerConfig, head_only: bool) -> None:
        self.config, self.head_only = config, head_only
        self.head: DeviceFilter = DeviceFilter(
            config.head_position, config.head_rotation, config.head_speed, config.turn_speed
        )
        hand = (config.hand_position, config.hand_rotation, config.hand_speed, config.turn_speed)
        self.hands: tuple[DeviceFilter, DeviceFilter] = (DeviceFilter(*hand), DeviceFilter(*hand))

    def reset(self) -> None:
        """Forget the past."""
        for device in (self.head, *self.hands):
            device.reset()

    @property
    def eye(self) -> Vec:
        """Position between the eyes as filtered, without prediction."""
        assert self.head.pose is not None
        return self.head.pose[0]

    def update(self, moment: Moment, prediction: float, flags: list[str]) -> Targets:
        """Return the solver's targets ``prediction`` seconds ahead; a lost head stays where it is."""
        if moment.head is not None:
            self.head.update(moment.head, moment.dt)
        assert self.head.pose is not None
        predicted = prediction > 0 and moment.head is not None
        targets = Targets(*(self.head.ahead(prediction, self.config) if predicted else self.head.pose))
        for side, (device, hand) in enumerate(zip(self.hands, moment.hands, strict=True)):
            if hand is None:
                if not self.head_only:
                    flags.append("right_lost" if side else "left_lost")
                device.reset()
                continue
            position, rotation = device.update(hand, moment.dt)
            if prediction > 0:
                position, rotation = device.ahead(prediction, self.config)
            if side:
                targets.right, targets.right_hand = position, rotation
            else:
                targets.left, targets.left_hand = position, rotation
        return targets
