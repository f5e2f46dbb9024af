"""Legs: feet that stay planted, step when balance or the gait asks, and crouch, tiptoe or hang as the pelvis says."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, exp, hypot, sin

from glsplat.tracking.solve.body import FEET, PELVIS, Body
from glsplat.tracking.solve.quat import (
    IDENTITY,
    Quat,
    Vec,
    add,
    clamp,
    rotate,
    scale,
    sub,
    wrap,
)
from glsplat.tracking.solve.stepping.clearance import TAKE_OFF, Clearance
from glsplat.tracking.solve.stepping.foot import HOLD, Foot
from glsplat.tracking.solve.stepping.gait import Gait
from glsplat.tracking.solve.stepping.leg import TIPTOE, Leg
from glsplat.tracking.solve.tracked import Follow

__all__ = ["Legs"]

STEP = 0.15  # metres a foot may be away from where balance wants it (of a 1.7 m person)
STEP_TURN = 0.45  # radians likewise
WIDEN = 2.0  # for each metre the pelvis is down
SETTLE = 0.6  # seconds of standing still after which half of that is too much
TURN_AHEAD = 0.3  # seconds a step looks ahead in a turn
STEP_TIME = 0.36  # seconds of a step out of standing
QUICK = 0.2  # likewise, of a step that a strained leg needs
BALANCE = 0.05  # metres the mass stands before the ankles, compared with the rest pose (over the middle of the foot)
STILL = 0.2  # m/s below which no leg is stretched unawares
FORESIGHT = 0.05  # seconds: a foot leaves the ground before its leg is stretched
TRACK = 1.0  # distance of the feet in the rest pose that a stance takes
NARROW = 0.55  # likewise, while walking
HURRY = 0.2  # seconds in which the feet of a recording that begins in mid-walk find their places
RUN = 1.6  # m/s (of a 1.7 m person) above which both feet may leave the ground in every stride

_NOWHERE = ((0.0, 0.0, 0.0), IDENTITY)


class Legs:
    """Two legs under a pelvis, on flat ground at y = 0."""

    turning: float
    yaw: float

    def __init__(self, body: Body) -> None:
        self.sole: float = body.sole
        self.legs: tuple[Leg, Leg] = (Leg(body, 0), Leg(body, 1))
        self.length: float = self.legs[0].length
        self.size: float = self.length / 0.83
        self.height: float = body.joints[PELVIS][1] - body.ground
        forward = (0.0, 0.0, BALANCE * self.size)
        self.home: tuple[Vec, ...] = tuple(
            [sub(sub(body.joints[FEET[i]], body.joints[PELVIS]), forward) for i in (0, 1)]
        )
        self.clearance: Clearance = Clearance(self.legs[0], self.sole)
        self.feet: tuple[Foot, Foot] = (Foot(0), Foot(1))
        self.follow: tuple[Follow, Follow] = (Follow(self.legs[0]), Follow(self.legs[1]))
        self.gait: Gait = Gait(self.length)
        self.started: bool = False
        self.given: Sequence[Foot] | None = None  # how the feet are before the first update
        self.flying: bool = False  # in a jump
        self.rest: Vec = (0.0, 0.0, 0.0)  # the base without its sway
        self.air: float = 0.0  # metres both feet are off the ground
        self.yaw = self.turning = 0.0  # rad, rad/s of the heading
        self.calm: float = 0.0  # seconds of standing still
        self.slack: float = 0.0  # metres left until the tiptoes lose the ground

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Forget the past; the next update plants both feet under the pelvis, or goes on with these."""
        self.started = self.flying = False
        self.given = feet
        self.air = self.slack = self.calm = 0.0
        self.gait.reset()
        for follow in self.follow:
            follow.reset()

    def middle(self) -> tuple[float, float] | None:
        """World x, z that the rest pose's pelvis would have over the feet; None before the first update."""
        if not self.started:
            return None
        x = z = 0.0
        for foot in self.feet:
            s, c = sin(foot.yaw), cos(foot.yaw)
            x += foot.x.at - self.home[foot.index][2] * s
            z += foot.z.at - self.home[foot.index][2] * c
        return 0.5 * x, 0.5 * z

    def place(self, index: int, base: Vec, yaw: float, track: float, lead: Vec) -> Vec:
        """Where foot ``index`` wants to stand for a base over yaw, ``lead`` ahead of it."""
        hx, _, hz = self.home[index]
        hx *= track
        s, c = sin(yaw), cos(yaw)
        return (base[0] + hx * c + hz * s + lead[0], self.sole, base[2] - hx * s + hz * c + lead[2])

    def update(
        self,
        base: Vec,  # the body's mass over the ground
        pelvis_at: Vec,
        pelvis: Quat,
        yaw: float,
        velocity: Vec,
        slow: Vec,  # m/s, smoothed for some 0.3 s in all: walking or only swaying
        speed: float,
        dt: float,
        goals: Sequence[tuple[Vec, Quat] | None] = (None, None),  # ankles and feet that are tracked
        knees: Sequence[Vec | None] = (None, None),
        shown: bool = True,
    ) -> list[tuple[Quat, Quat, Quat]]:
        """World rotation of thigh, local rotation of the knee, and world rotation of the foot, for left and right.

        Nothing for legs that are not ``shown``: whether they strain is then as it was when they were solved last.
        """
        hips = [add(pelvis_at, rotate(pelvis, leg.hip)) for leg in self.legs]
        if not self.started:
            for foot in self.feet:
                if self.given is None:
                    foot.plant(self.place(foot.index, base, yaw, TRACK, (0.0, 0.0, 0.0)), yaw)
                else:
                    foot.take_over(self.given[foot.index], QUICK, 0.05 * self.size)
            self.rest, self.yaw, self.turning, self.started = base, yaw, 0.0, True
        for foot, goal, knee in zip(self.feet, goals, knees, strict=True):
            self.follow[foot.index].place(foot, goal, knee, dt)
        k = 1 - exp(-dt / 0.1)
        self.turning += (wrap(yaw - self.yaw) / max(dt, 1e-4) - self.turning) * k
        self.yaw = yaw
        k = 1 - exp(-dt / 0.4)
        self.rest = (self.rest[0] + (base[0] - self.rest[0]) * k, 0.0, self.rest[2] + (base[2] - self.rest[2]) * k)
        if speed > STILL:
            for leg, foot, hip in zip(self.legs, self.feet, hips, strict=True):
                if foot.planted and not foot.strained and self.follow[foot.index].ankle is None:
                    foot.strained = leg.strains(foot, add(hip, scale(velocity, FORESIGHT)), pelvis)
        self.slack, self.air = self.clearance.of(hips, self.follow)
        running = self.gait.walking and speed > RUN * self.gait.pace
        if not self._free():
            self.flying = False
        elif self.air > (0 if self.flying else TAKE_OFF) and not running:
            self._fly(base, yaw, dt)
        else:
            if self.flying:  # they land where they are
                for foot in self._free():
                    foot.land()
            self.flying = False
            if self.gait.walking:
                self._walk(base, yaw, velocity, speed, dt)
            else:
                self._stand(base, yaw, slow, speed, pelvis_at[1], dt)
        if not shown:
            return []
        return [
            follow.solve(foot, hip, pelvis, yaw) or follow.leg.solve(foot, hip, pelvis, yaw)
            for follow, foot, hip in zip(self.follow, self.feet, hips, strict=True)
        ]

    # -- feet that are tracked

    def _free(self) -> list[Foot]:
        """Those that are not."""
        return [foot for foot in self.feet if self.follow[foot.index].ankle is None]

    def _fly(self, base: Vec, yaw: float, dt: float) -> None:
        """In a jump the feet hang under the hips."""
        self.flying, off = True, self.air > TAKE_OFF
        for foot in self._free():
            foot.planted, foot.left = False, 0.0
            x, _, z = self.place(foot.index, base, yaw, TRACK, (0.0, 0.0, 0.0)) if off else foot.ball
            foot.hang((x, self.sole + self.air, z), yaw if off else foot.yaw, TIPTOE if off else foot.tilt.at, dt)

    # -- steps

    def start_walking(self, speed: float) -> None:
        """A recording that begins in mid-walk: the feet hurry to where the phase has them."""
        duty = self.gait.duty(speed)
        for foot in self._free():
            phase = (self.gait.phase + 0.5 * foot.index) % 1.0
            left = (1 - phase) / self.gait.frequency
            by_gait = phase > duty and left > HURRY
            foot.lift(left if by_gait else HURRY, 0.05 * self.size, by_gait)

    def _walk(self, base: Vec, yaw: float, velocity: Vec, speed: float, dt: float) -> None:
        """Feet by the gait's phase."""
        gait = self.gait
        duty = gait.duty(speed)
        v = speed / gait.pace
        running = clamp((v - RUN) / 0.6, 0.0, 1.0)
        height = self.size * (0.05 + 0.02 * v + running * 0.07 * (v - RUN))
        stance, swing = duty / gait.frequency, (1 - duty) / gait.frequency
        ahead = 0.5 * stance + HOLD * swing
        back = -(0.06 + 0.18 * running) * self.size  # runners land under their mass
        late = 0.03 + 0.04 * running  # the ball lands after the heel, by this part of a stride
        for foot in self._free():
            phase = (gait.phase - late + 0.5 * foot.index) % 1.0
            left = (1 - phase) / gait.frequency  # seconds until the foot is due on the ground
            if foot.planted:
                strained = foot.strained and self._helps(foot, self._landing(foot, base, yaw, velocity, ahead, back))
                if strained and phase < 0.5 * duty:
                    foot.lift(QUICK, height, False)
                elif strained or duty < phase < duty + 0.6 * (1 - duty):
                    foot.lift(min(left, 1.3 * swing), height, True)
            if foot.planted:
                # the heel leaves the ground late in stance
                heel = clamp((phase / duty - 0.6) / 0.4, 0.0, 1.0)
                foot.stand(self.sole + self.air, 0.7 * min(v / 1.3, 1.2) * heel * heel, dt)
                continue
            down = 0.0  # the phase at which it lands
            if not foot.by_gait or phase < 0.3:
                left = foot.left - dt
                down = (phase + max(left, 0.0) * gait.frequency) % 1.0
                down = min(down, duty) if down < 0.5 * (1 + duty) else 0.0
            over = max(min(left, foot.left) - HOLD * foot.duration, 0.0)
            landing = self._landing(foot, base, yaw, velocity, ahead - down * stance / duty + over, back)
            foot.swing(landing, yaw, left, speed, dt)

    def _landing(self, foot: Foot, base: Vec, yaw: float, velocity: Vec, ahead: float, back: float) -> Vec:
        """Where a foot comes down that the body is to pass in half a stance from then."""
        x, y, z = self.place(foot.index, base, yaw, NARROW, (velocity[0] * ahead, 0.0, velocity[2] * ahead))
        return (x + back * sin(yaw), y, z + back * cos(yaw))

    def _stand(self, base: Vec, yaw: float, slow: Vec, speed: float, low: float, dt: float) -> None:
        lead = (slow[0] * 0.4, 0.0, slow[2] * 0.4)
        base, yaw = self.rest, wrap(yaw + clamp(TURN_AHEAD * self.turning, -0.6, 0.6))
        # a lower pelvis goes with a wider stance
        track = TRACK * (1 + clamp(WIDEN * (self.height - low) / self.size, 0.0, 1.0))
        worst, asks = 0.0, None
        for foot in self._free():
            target = self.place(foot.index, base, yaw, track, lead)
            if not foot.planted:
                foot.swing(target, yaw, foot.left - dt, speed, dt)
                continue
            foot.stand(self.sole + self.air, 0.0, dt)
            if foot.strained and self._helps(foot, target):
                foot.lift(QUICK, 0.05 * self.size, False)
                continue
            far = hypot(target[0] - foot.x.at, target[2] - foot.z.at) / (STEP * self.size)
            turn = abs(wrap(yaw - foot.yaw)) / STEP_TURN
            need = max(far, turn)
            if need > worst:
                worst, asks = need, foot
        # who stands still for a while puts a foot that stands badly right
        both = self.feet[0].planted and self.feet[1].planted
        calm = both and hypot(slow[0], slow[2]) < 0.08
        self.calm = self.calm + dt if calm else 0.0
        enough = 1.0 if self.calm < SETTLE else 0.5
        if asks is not None and worst > enough and both:
            asks.lift(STEP_TIME * clamp(1.3 - 0.2 * worst, 0.6, 1.0), 0.05 * self.size, False)

    def _helps(self, foot: Foot, target: Vec) -> bool:
        """Would a step bring a foot that strains its leg to another place?"""
        far = hypot(target[0] - foot.x.at, target[2] - foot.z.at)
        return far > 0.06 * self.size or abs(wrap(self.yaw - foot.yaw)) > 0.25
