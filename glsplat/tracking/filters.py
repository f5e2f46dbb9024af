"""One Euro filters for positions and rotations: steady when still, quick when moving; and bounded prediction.

Casiez, Roussel & Vogel, "1 Euro Filter: A Simple Speed-based Low-pass Filter for Noisy Input in Interactive Systems",
CHI 2012: a first-order low pass whose cutoff grows with the speed, fc = min_cutoff + beta |speed|. One speed serves all
coordinates, so the filter has no preferred axis. A first-order low pass cannot overshoot. It lags by 1 / (2 pi fc): at
rest 1 / (2 pi min_cutoff) seconds; at speed the distance behind is below 1 / (2 pi beta), whatever the speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, exp, pi, sqrt

from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, clamp, mul, nlerp, to_quat

__all__ = ["Device", "OneEuro", "PositionFilter", "RotationFilter"]


@dataclass(frozen=True, slots=True)
class OneEuro:
    """Setting of one channel."""

    min_cutoff: float  # Hz at rest; 0 switches the filter off
    beta: float  # Hz for each m/s (positions) or rad/s (rotations)
    derivative_cutoff: float = 4.0  # Hz, smoothing of the speed itself

    def lag(self, speed: float) -> float:
        """Seconds by which the filter delays a motion of this speed (m/s or rad/s)."""
        return 0.0 if self.min_cutoff <= 0 else 1 / (2 * pi * (self.min_cutoff + self.beta * speed))


class PositionFilter:
    """One Euro on a point, with a limit on its speed."""

    max_speed: float
    setting: OneEuro

    def __init__(self, setting: OneEuro, max_speed: float) -> None:
        self.setting, self.max_speed = setting, max_speed
        self.value: Vec | None = None
        self.velocity: Vec = (0.0, 0.0, 0.0)

    def reset(self) -> None:
        """Forget the past: the next value passes unchanged."""
        self.value, self.velocity = None, (0.0, 0.0, 0.0)

    def update(self, raw: Vec, dt: float) -> Vec:
        """The filtered point ``dt`` seconds after the last one."""
        last = self.value
        if last is None:
            self.value = raw
            return raw
        dx, dy, dz = raw[0] - last[0], raw[1] - last[1], raw[2] - last[2]
        far = sqrt(dx * dx + dy * dy + dz * dz)
        most = self.max_speed * dt
        if far > most:
            k = most / far
            dx, dy, dz = dx * k, dy * k, dz * k
        s = self.setting
        a = 1 - exp(-2 * pi * s.derivative_cutoff * dt)
        vx, vy, vz = self.velocity
        rate = 1 / dt
        vx, vy, vz = vx + (dx * rate - vx) * a, vy + (dy * rate - vy) * a, vz + (dz * rate - vz) * a
        self.velocity = (vx, vy, vz)
        if s.min_cutoff > 0:
            k = 1 - exp(-2 * pi * (s.min_cutoff + s.beta * sqrt(vx * vx + vy * vy + vz * vz)) * dt)
            dx, dy, dz = dx * k, dy * k, dz * k
        self.value = value = (last[0] + dx, last[1] + dy, last[2] + dz)
        return value

    def ahead(self, seconds: float, most: float) -> Vec:
        """The value extrapolated at its present velocity, at most ``most`` metres."""
        x, y, z = self.value or (0.0, 0.0, 0.0)
        vx, vy, vz = self.velocity
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        k = seconds if speed * seconds <= most else most / speed
        return (x + vx * k, y + vy * k, z + vz * k)


class RotationFilter:
    """One Euro on a unit quaternion, whichever its sign, with a limit on its speed."""

    max_speed: float
    setting: OneEuro

    def __init__(self, setting: OneEuro, max_speed: float) -> None:
        self.setting, self.max_speed = setting, max_speed
        self.value: Quat | None = None
        self.velocity: Vec = (0.0, 0.0, 0.0)  # rad/s, world axes

    def reset(self) -> None:
        """Forget the past: the next value passes unchanged."""
        self.value, self.velocity = None, (0.0, 0.0, 0.0)

    def update(self, raw: Quat, dt: float) -> Quat:
        """The filtered rotation ``dt`` seconds after the last one."""
        last = self.value
        if last is None:
            self.value = raw
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
        s = self.setting
        a = 1 - exp(-2 * pi * s.derivative_cutoff * dt)
        rate = 1 / dt
        vx, vy, vz = self.velocity
        vx, vy, vz = vx + (x * rate - vx) * a, vy + (y * rate - vy) * a, vz + (z * rate - vz) * a
        self.velocity = (vx, vy, vz)
        k = angle and min(angle, most) / angle
        if s.min_cutoff > 0:
            k *= 1 - exp(-2 * pi * (s.min_cutoff + s.beta * sqrt(vx * vx + vy * vy + vz * vz)) * dt)
        self.value = value = (
            nlerp(last, raw, k) if angle < 0.5 else mul(to_quat(_scaled(x, y, z, k, angle, most)), last)
        )
        return value

    def ahead(self, seconds: float, most: float) -> Quat:
        """The value turned on at its present angular velocity, by at most ``most`` radians."""
        vx, vy, vz = self.velocity
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        k = seconds if speed * seconds <= most else most / speed
        return mul(to_quat((vx * k, vy * k, vz * k)), self.value or (1.0, 0.0, 0.0, 0.0))


@dataclass(slots=True)
class Device:
    """Filters of one tracked pose."""

    position: PositionFilter
    rotation: RotationFilter
    at: Vec | None = None
    turn: Quat = IDENTITY
    raw: tuple[float, ...] | None = None
    frozen: int = 0

    def reset(self) -> None:
        """Not seen any more: the next pose is taken as it comes."""
        self.position.reset()
        self.rotation.reset()
        self.at = None


def _scaled(x: float, y: float, z: float, k: float, angle: float, most: float) -> Vec:
    """The allowed turn (x, y, z), shortened to the part k of the whole turn."""
    allowed = min(angle, most)
    f = clamp(k * angle / allowed, 0.0, 1.0) if allowed > 1e-12 else 0.0
    return (x * f, y * f, z * f)
