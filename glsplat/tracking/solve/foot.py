"""A foot: planted, or on a swing that stays smooth however its landing position and time change on the way."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import hypot

from glsplat.tracking.solve.quat import Vec, clamp, wrap

HOLD = 0.06  # part of a swing, at either end, in which the foot goes straight up or down, so that it never slides
RISE, SINK = 0.28, 0.28  # parts of a swing in which the foot goes up, and down
MAX_RISE_S = 0.12  # likewise, and to sink: it must not slide
FINAL_S = 0.11  # before the foot comes down, in which its landing position no longer changes
STANCE_S = 0.08  # in which a planted foot takes up a new pitch, and sinks onto the ground it was pulled off
HURRY, LINGER = 1.6, 0.5  # how much faster or slower than the clock a swing's end may come nearer
HANG_S, HANG_HEIGHT_S, HANG_PITCH_S = 0.2, 0.06, 0.15  # in which feet in the air come under the hips
MAX_FOOT_SPEED = 8.0  # m/s of a swinging foot over the body's
PEAK_OF_MEAN_SPEED = 1.875  # of a minimum-jerk path
MIN_SWING_S = 0.12
MIN_TURN_S = 0.04  # in which a swinging foot takes up its heading


@dataclass(slots=True)
class Axis:
    """One coordinate with its velocity and acceleration."""

    at: float = 0.0
    speed: float = 0.0
    pull: float = 0.0

    def put(self, at: float) -> None:
        """Move there at once, at rest."""
        self.at, self.speed, self.pull = at, 0.0, 0.0

    def approach(self, target: float, left: float, dt: float) -> None:
        """Advance by dt on the minimum-jerk path to rest at ``target`` in ``left`` seconds.

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
    """One foot: position of its ball, heading, how far the heel is up, and its swing."""

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
    strained: bool = False  # the leg does not reach the planted foot

    @property
    def ball(self) -> Vec:
        """World position of the foot joint."""
        return (self.x.at, self.y.at, self.z.at)

    @property
    def yaw(self) -> float:
        """Heading in the world, radians."""
        return self.turn.at

    def plant(self, place: Vec, yaw: float) -> None:
        """Put the foot on the ground at once: the beginning."""
        for axis, value in zip(self.axes, (*place, yaw, 0.0), strict=True):
            axis.put(value)
        self.planted, self.strained = True, False

    def lift(self, duration: float, height: float, by_gait: bool) -> None:
        """Begin a swing that lasts ``duration`` seconds."""
        duration = max(duration, MIN_SWING_S)
        self.planted, self.by_gait = False, by_gait
        self.duration = self.left = duration
        self.height = height
        self.landing = self.ball

    def take_over(self, other: Foot, duration: float, height: float) -> None:
        """Go on as another solver's foot; one in the air lands in ``duration`` seconds."""
        for mine, its in zip(self.axes, other.axes, strict=True):
            mine.at, mine.speed, mine.pull = its.at, its.speed, its.pull
        self.planted, self.strained = True, other.strained
        if not other.planted:
            self.lift(duration, height, False)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Position, heading and pitch."""
        return (self.x, self.y, self.z, self.turn, self.tilt)

    def stand(self, sole: float, pitch: float, dt: float) -> None:
        """Keep the foot planted, its heel up by ``pitch``."""
        if self.y.at != sole:
            self.y.approach(sole, STANCE_S, dt)
            if abs(self.y.at - sole) + abs(self.y.speed) * STANCE_S < 1e-4:
                self.y.put(sole)
        if self.tilt.at != pitch or self.tilt.speed:
            self.tilt.approach(pitch, STANCE_S, dt)
            if not pitch and abs(self.tilt.at) < 1e-4 and abs(self.tilt.speed) < 1e-2:
                self.tilt.put(0.0)

    def swing(self, landing: Vec, yaw: float, left: float, pace: float, dt: float) -> None:
        """Move the foot up first, then over, then down.

        ``left``: seconds until the foot should be down, which is delayed where it would exceed a foot's speed.
        ``pace``: m/s of the body.
        """
        before, whole = self.left, self.duration
        left = clamp(left, before - HURRY * dt, before - LINGER * dt)
        over = left - HOLD * whole
        if over > FINAL_S:
            far = hypot(landing[0] - self.x.at, landing[2] - self.z.at)
            needed = PEAK_OF_MEAN_SPEED * far / (MAX_FOOT_SPEED + PEAK_OF_MEAN_SPEED * pace)
            left = min(max(left, HOLD * whole + needed), max(before, left))
        self.left = left
        over = left - HOLD * whole  # until the foot is over its place
        if over > FINAL_S:
            self.landing = landing
        if before < (1 - HOLD) * whole:
            x, _, z = self.landing
            self.x.approach(x, over + dt, dt)
            self.z.approach(z, over + dt, dt)
            self.turn.approach(self.turn.at + wrap(yaw - self.turn.at), max(over, MIN_TURN_S) + dt, dt)
        sole = self.landing[1]
        rise = left - whole + min(RISE * whole, MAX_RISE_S)
        if rise > 0:
            self.y.approach(sole + self.height, rise + dt, dt)
        elif left > min(SINK * whole, MAX_RISE_S):
            self.y.approach(sole + self.height, MAX_RISE_S, dt)
        else:
            self.y.approach(sole, left + dt, dt)
        self.tilt.approach(0.0, left + dt, dt)
        if left <= 0:
            self.land()

    def land(self) -> None:
        """Stop on the ground, here."""
        for axis in (self.x, self.z, self.turn):
            axis.put(axis.at)
        self.planted, self.left = True, 0.0

    def hang(self, place: Vec, yaw: float, pitch: float, dt: float) -> None:
        """Move the foot towards ``place`` in the air, under the hips."""
        self.x.approach(place[0], HANG_S, dt)
        self.z.approach(place[2], HANG_S, dt)
        self.y.approach(place[1], HANG_HEIGHT_S, dt)
        self.turn.approach(self.turn.at + wrap(yaw - self.turn.at), HANG_S, dt)
        self.tilt.approach(pitch, HANG_PITCH_S, dt)
