"""A foot: planted, or on a swing that stays smooth whatever happens to its landing place and its time on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot

from glsplat.tracking.solve.quat import Vec, clamp, wrap

__all__ = ["HOLD", "Axis", "Foot"]

HOLD = 0.06  # of a swing, at either end: the foot goes straight up or down, so that it never slides
RISES, SINKS = 0.28, 0.28  # of a swing in which the foot goes up, and down
SOON = 0.12  # seconds at most for either: it must not slide
CHOSEN = 0.11  # seconds before the foot comes down in which its place is no longer changed
STEADY = 0.08  # seconds in which a planted foot takes up a new pitch, and sinks onto the ground it was pulled off
HURRY, LINGER = 1.6, 0.5  # how much faster or slower than the clock a swing's end may come nearer
HANG = 0.2  # seconds in which feet in the air come under the hips
FASTEST = 8.0  # m/s a swinging foot overtakes the body with; 1.875 times its mean on a minimum-jerk path
BRIEFEST = 0.12  # seconds of a swing


@dataclass(slots=True)
class Axis:
    """One coordinate with its velocity and acceleration."""

    at: float = 0.0
    speed: float = 0.0
    pull: float = 0.0

    def put(self, at: float) -> None:
        """There, at rest."""
        self.at, self.speed, self.pull = at, 0.0, 0.0

    def approach(self, target: float, left: float, dt: float) -> None:
        """Go on for dt on the minimum-jerk path to rest at ``target`` in ``left`` seconds.

        Planned anew from the present state at every sample (Hoff & Arbib 1993), so position, velocity and acceleration
        are continuous however target and time move. With a constant ``left`` it is a low pass of third order.
        """
        if left <= dt:
            self.put(target)
            return
        s = dt / left
        way, v, a = target - self.at, self.speed * left, self.pull * left * left
        c3 = 10 * way - 6 * v - 1.5 * a
        c4 = -15 * way + 8 * v + 1.5 * a
        c5 = 6 * way - 3 * v - 0.5 * a
        self.at += s * (v + s * (0.5 * a + s * (c3 + s * (c4 + s * c5))))
        self.speed = (v + s * (a + s * (3 * c3 + s * (4 * c4 + s * 5 * c5)))) / left
        self.pull = (a + s * (6 * c3 + s * (12 * c4 + s * 20 * c5))) / (left * left)


@dataclass(slots=True)
class Foot:
    """One foot: where its ball is, its heading, how far the heel is up, and its swing if it is on one."""

    index: int  # 0 left, 1 right
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    z: Axis = field(default_factory=Axis)
    turn: Axis = field(default_factory=Axis)  # heading, radians; unwrapped
    tilt: Axis = field(default_factory=Axis)  # radians, heel up
    planted: bool = True
    by_gait: bool = False  # the swing's end follows the gait's phase, not a clock
    duration: float = 0.36  # seconds of this swing
    left: float = 0.0  # seconds until it ends
    height: float = 0.05  # metres
    landing: Vec = (0.0, 0.0, 0.0)
    strained: bool = False  # the leg does not reach where the foot is planted

    @property
    def ball(self) -> Vec:
        """World place of the foot joint."""
        return (self.x.at, self.y.at, self.z.at)

    @property
    def yaw(self) -> float:
        """Heading in the world, radians."""
        return self.turn.at

    def plant(self, place: Vec, yaw: float) -> None:
        """On the ground at once: the beginning."""
        self.x.put(place[0])
        self.y.put(place[1])
        self.z.put(place[2])
        self.turn.put(yaw)
        self.tilt.put(0.0)
        self.planted, self.strained = True, False

    def lift(self, duration: float, height: float, by_gait: bool) -> None:
        """Begin a swing that lasts this long."""
        duration = max(duration, BRIEFEST)
        self.planted, self.by_gait = False, by_gait
        self.duration = self.left = duration
        self.height = height
        self.landing = self.ball

    def take_over(self, other: Foot, duration: float, height: float) -> None:
        """Go on as another solver's foot; one in the air is to land in ``duration`` seconds."""
        for mine, its in zip(self._channels, other._channels, strict=True):
            mine.at, mine.speed, mine.pull = its.at, its.speed, its.pull
        self.planted, self.strained = True, other.strained
        if not other.planted:
            self.lift(duration, height, False)

    @property
    def _channels(self) -> tuple[Axis, ...]:
        return (self.x, self.y, self.z, self.turn, self.tilt)

    def stand(self, sole: float, pitch: float, dt: float) -> None:
        """A planted foot: the heel where the stance has it."""
        if self.y.at != sole:
            self.y.approach(sole, STEADY, dt)
            if abs(self.y.at - sole) + abs(self.y.speed) * STEADY < 1e-4:
                self.y.put(sole)
        if self.tilt.at != pitch or self.tilt.speed:
            self.tilt.approach(pitch, STEADY, dt)
            if not pitch and abs(self.tilt.at) < 1e-4 and abs(self.tilt.speed) < 1e-2:
                self.tilt.put(0.0)

    def swing(self, landing: Vec, yaw: float, left: float, pace: float, dt: float) -> None:
        """Up first, then over, then down.

        ``left``: seconds until the foot should be down, which is put off where it would have to be faster than a foot
        is. ``pace``: m/s of the body.
        """
        before, whole = self.left, self.duration
        left = clamp(left, before - HURRY * dt, before - LINGER * dt)
        over = left - HOLD * whole
        if over > CHOSEN:
            far = hypot(landing[0] - self.x.at, landing[2] - self.z.at)
            left = min(max(left, HOLD * whole + 1.875 * far / (FASTEST + 1.875 * pace)), max(before, left))
        self.left = left
        over = left - HOLD * whole  # until the foot is over its place
        if over > CHOSEN:
            self.landing = landing
        if before < (1 - HOLD) * whole:
            x, _, z = self.landing
            self.x.approach(x, over + dt, dt)
            self.z.approach(z, over + dt, dt)
            self.turn.approach(self.turn.at + wrap(yaw - self.turn.at), max(over, 0.04) + dt, dt)
        sole = self.landing[1]
        rise = left - whole + min(RISES * whole, SOON)
        if rise > 0:
            self.y.approach(sole + self.height, rise + dt, dt)
        elif left > min(SINKS * whole, SOON):
            self.y.approach(sole + self.height, SOON, dt)
        else:
            self.y.approach(sole, left + dt, dt)
        self.tilt.approach(0.0, left + dt, dt)
        if left <= 0:
            self.land()

    def land(self) -> None:
        """On the ground, here."""
        for channel in (self.x, self.z, self.turn):
            channel.put(channel.at)
        self.planted, self.left = True, 0.0

    def hang(self, place: Vec, yaw: float, pitch: float, dt: float) -> None:
        """In the air, under the hips."""
        self.x.approach(place[0], HANG, dt)
        self.z.approach(place[2], HANG, dt)
        self.y.approach(place[1], 0.06, dt)
        self.turn.approach(self.turn.at + wrap(yaw - self.turn.at), HANG, dt)
        self.tilt.approach(pitch, 0.15, dt)
