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
from dataclasses import dataclass
from math import acos, exp, pi, sqrt
from typing import Generic, TypeVar

from glsplat.tracking.solve.quat import (
    IDENTITY,
    Quat,
    Vec,
    add,
    clamp,
    conj,
    length,
    mul,
    nlerp,
    pull,
    rotation_vector,
    scale,
    slerp,
    sub,
    to_quat,
)

__all__ = ["Device", "OneEuro", "PositionFilter", "RotationFilter"]

Value = TypeVar("Value", bound=tuple[float, ...])


@dataclass(frozen=True, slots=True)
class OneEuro:
    """Setting of one channel."""

    min_cutoff: float  # Hz at rest; 0 switches the filter off
    beta: float  # Hz for each m/s (positions) or rad/s (rotations)
    knee: float = 0.0  # m/s or rad/s below which the cutoff grows with the square of the speed: sway is not motion yet
    derivative_cutoff: float = 4.0  # Hz, smoothing of the speed itself

    def cutoff(self, speed: float) -> float:
        """Hz at this speed."""
        return self.min_cutoff + self.beta * speed * (1.0 if speed >= self.knee else speed / self.knee)

    def share(self, speed: float, dt: float) -> float:
        """Of the way to its input that each of the two low passes goes in dt seconds."""
        return 1.0 if self.min_cutoff <= 0 else 1 - exp(-4 * pi * self.cutoff(speed) * dt)

    def lag(self, speed: float) -> float:
        """Seconds by which the filter delays a motion of this speed (m/s or rad/s)."""
        return 0.0 if self.min_cutoff <= 0 else 1 / (2 * pi * self.cutoff(speed))


SPAN = 0.1
"""Seconds of the past that a prediction goes by: shorter ones tremble more, longer ones come later."""

_FEWEST, _ENOUGH = 4, 0.7  # points, and the part of SPAN that they reach back
_MOST = 64  # points: no device is that quick, but a client may say so


class Trend:
    """The velocity of the last ``SPAN`` seconds: the slope of the line through them (least squares).

    Steps faster than ``max_speed`` are cut to it: a device that is found elsewhere has not moved there.
    """

    def __init__(self, max_speed: float) -> None:
        self._past: deque[tuple[float, Vec]] = deque(maxlen=_MOST)  # seconds, and how far it had come
        self._most, self._now = max_speed, 0.0
        self._come: Vec = (0.0, 0.0, 0.0)

    def add(self, step: Vec, dt: float) -> None:
        """It moved by ``step`` in ``dt`` seconds."""
        self._now += dt
        far, most = length(step), self._most * dt
        self._come = add(self._come, step if far <= most else scale(step, most / far))
        self._past.append((self._now, self._come))
        while self._now - self._past[0][0] > SPAN:
            self._past.popleft()

    def velocity(self) -> Vec | None:
        """A second; None before there is a past to go by."""
        if len(self._past) < _FEWEST or self._now - self._past[0][0] < _ENOUGH * SPAN:
            return None
        middle = sum(t for t, _ in self._past) / len(self._past)
        spread = sum((t - middle) ** 2 for t, _ in self._past)
        x, y, z = (sum((t - middle) * at[k] for t, at in self._past) / spread for k in range(3))
        return (x, y, z)


class _Filter(Generic[Value]):
    """One Euro with a limit on the speed, on what moves in three directions: what points and rotations share."""

    def __init__(self, setting: OneEuro, max_speed: float) -> None:
        self.setting, self.max_speed = setting, max_speed
        self.first: Value | None = None  # behind the first low pass
        self.value: Value | None = None
        self.velocity: Vec = (0.0, 0.0, 0.0)
        self.trend: Trend | None = None  # of all moves together, once something was predicted
        self._raw: Value | None = None

    def reset(self) -> None:
        """Forget the past: the next value passes unchanged."""
        self.first = self.value = self.trend = self._raw = None
        self.velocity = (0.0, 0.0, 0.0)

    def _share(self, x: float, y: float, z: float, dt: float) -> float:
        """Of the way to its input that each low pass goes, once the velocity has taken up a move in dt seconds."""
        setting = self.setting
        a = 1 - exp(-2 * pi * setting.derivative_cutoff * dt)
        rate = 1 / dt
        vx, vy, vz = self.velocity
        vx, vy, vz = vx + (x * rate - vx) * a, vy + (y * rate - vy) * a, vz + (z * rate - vz) * a
        self.velocity = (vx, vy, vz)
        return setting.share(sqrt(vx * vx + vy * vy + vz * vz), dt)

    def _move(self, seconds: float, most: float) -> Vec:
        """How it moves on in that time at its present velocity, by at most ``most``."""
        self.trend = self.trend or Trend(self.max_speed)
        vx, vy, vz = self.trend.velocity() or self.velocity
        speed = sqrt(vx * vx + vy * vy + vz * vz)
        k = seconds if speed * seconds <= most else most / speed
        return (vx * k, vy * k, vz * k)


class PositionFilter(_Filter[Vec]):
    """One Euro on a point, with a limit on its speed."""

    def update(self, raw: Vec, dt: float) -> Vec:
        """The filtered point ``dt`` seconds after the last one."""
        last, value = self.first, self.value
        if self.trend is not None:
            self.trend.add(sub(raw, self._raw or raw), dt)
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
        """The value extrapolated at its present velocity, at most ``most`` metres."""
        return add(self.value or (0.0, 0.0, 0.0), self._move(seconds, most))


class RotationFilter(_Filter[Quat]):
    """One Euro on a unit quaternion, whichever its sign, with a limit on its speed; velocity in rad/s, world axes."""

    def update(self, raw: Quat, dt: float) -> Quat:
        """The filtered rotation ``dt`` seconds after the last one."""
        last, value = self.first, self.value
        if self.trend is not None:
            self.trend.add(rotation_vector(mul(raw, conj(self._raw or raw))), dt)
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
        k = (angle and min(angle, most) / angle) * share
        first = nlerp(last, raw, k) if angle < 0.5 else mul(to_quat(_scaled(x, y, z, k, angle, most)), last)
        self.first = first
        self.value = value = first if share == 1 else slerp(value, first, share)
        return value

    def ahead(self, seconds: float, most: float) -> Quat:
        """The value turned on at its present angular velocity, by at most ``most`` radians."""
        return mul(to_quat(self._move(seconds, most)), self.value or IDENTITY)


@dataclass(slots=True)
class Device:
    """Filters of one tracked pose."""

    position: PositionFilter
    rotation: RotationFilter
    at: Vec | None = None
    turn: Quat = IDENTITY
    raw: tuple[float, ...] | None = None
    frozen: int = 0

    def ahead(self, seconds: float, metres: float, radians: float) -> tuple[Vec, Quat]:
        """Where it will be, as far as that may differ from where it is."""
        return self.position.ahead(seconds, metres), self.rotation.ahead(seconds, radians)

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
