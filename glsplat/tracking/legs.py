"""Legs: feet that stay planted, step when balance or the gait asks, and crouch, tiptoe or hang as the pelvis says."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, exp, hypot, sin, sqrt

from glsplat.tracking.body import ANKLES, FEET, HIPS, KNEES, PELVIS, Body
from glsplat.tracking.gait import Gait
from glsplat.tracking.limb import Limb, two_bone
from glsplat.tracking.quat import Quat, Vec, clamp, mul, rotate, to_quat, unit, wrap, yaw_quat

__all__ = ["Foot", "Legs"]

KNEE_FLEXION = 145.0  # degrees the knee may bend
DORSIFLEXION = 0.66  # radians the ankle bends under load
TIPTOE = 1.0  # radians the heel may lift about the ball
HOLD = 0.11  # of a swing, at either end: the foot goes straight up or down, so that it never slides
STEP = 0.17  # metres a foot may be away from where balance wants it (of a 1.7 m person)
STEP_TURN = 0.45  # radians likewise
WIDEN = 2.0  # for each metre the pelvis is down
SETTLE = 0.6  # seconds of standing still after which half of that is too much
TURN_AHEAD = 0.3  # seconds a step looks ahead in a turn
STEP_TIME = 0.36  # seconds of a step out of standing
BALANCE = 0.05  # metres the mass stands before the ankles, compared with the rest pose (over the middle of the foot)
TRACK = 1.0  # distance of the feet in the rest pose that a stance takes; 0.55 while walking


@dataclass(slots=True)
class Foot:
    """One foot: the ball on the ground (or in the air), its heading and how far the heel is up."""

    index: int  # 0 left, 1 right
    ball: Vec = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    pitch: float = 0.0  # radians, heel up
    planted: bool = True
    progress: float = 0.0  # of the swing, 0..1
    from_phase: float = 0.0  # of the gait, where the swing began
    by_gait: bool = False  # the swing follows the gait's phase, not a clock
    duration: float = STEP_TIME
    start: Vec = (0.0, 0.0, 0.0)
    start_from: Vec = (0.0, 0.0, 0.0)  # from the base, when the foot leaves its place
    start_yaw: float = 0.0
    start_pitch: float = 0.0
    height: float = 0.05
    strained: bool = False  # the leg does not reach where the foot is planted


class Legs:
    """Two legs under a pelvis, on flat ground at y = 0."""

    def __init__(self, body: Body) -> None:
        self.sole = body.sole
        self.hip = tuple([_minus(body.joints[h], body.joints[PELVIS]) for h in HIPS])
        self.limb = tuple(
            [Limb.of(body, (HIPS[i], KNEES[i], ANKLES[i]), (1.0, 0.0, 0.0), KNEE_FLEXION, 0.997) for i in (0, 1)]
        )
        self.length = self.limb[0].upper + self.limb[0].lower
        self.size = self.length / 0.83
        self.height = body.joints[PELVIS][1] - body.ground
        self.ankle = tuple([_minus(body.joints[ANKLES[i]], body.joints[FEET[i]]) for i in (0, 1)])  # from the ball
        forward = (0.0, 0.0, BALANCE * self.size)
        self.home = tuple([_minus(_minus(body.joints[FEET[i]], body.joints[PELVIS]), forward) for i in (0, 1)])
        _, up, back = self.ankle[0]
        self.tiptoe = up * cos(TIPTOE) - back * sin(TIPTOE) - up  # metres the ankle rises on tiptoe
        self.feet = (Foot(0), Foot(1))
        self.gait = Gait(self.length)
        self.started = False
        self.rest: Vec = (0.0, 0.0, 0.0)  # the base without its sway
        self.air = 0.0  # metres both feet are off the ground
        self.yaw = self.turning = 0.0  # rad, rad/s of the heading
        self.calm = 0.0  # seconds of standing still
        self.slack = 0.0  # metres left until the tiptoes lose the ground

    def reset(self) -> None:
        """Forget the past; the next update plants both feet under the pelvis."""
        self.started = False
        self.air = self.slack = self.calm = 0.0
        self.gait.reset()

    def middle(self) -> tuple[float, float] | None:
        """World x, z that the rest pose's pelvis would have over the feet; None before the first update."""
        if not self.started:
            return None
        x = z = 0.0
        for foot in self.feet:
            s, c = sin(foot.yaw), cos(foot.yaw)
            x += foot.ball[0] - self.home[foot.index][2] * s
            z += foot.ball[2] - self.home[foot.index][2] * c
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
        slow: Vec,  # m/s over the last stride
        speed: float,
        dt: float,
    ) -> list[tuple[Quat, Quat, Quat]]:
        """World rotation of thigh, local rotation of the knee, and world rotation of the foot, for left and right."""
        hips = [_plus(pelvis_at, rotate(pelvis, offset)) for offset in self.hip]
        if not self.started:
            self._plant(base, yaw, velocity, speed)
            self.rest, self.yaw, self.turning = base, yaw, 0.0
        k = 1 - exp(-dt / 0.1)
        self.turning += (wrap(yaw - self.yaw) / max(dt, 1e-4) - self.turning) * k
        self.yaw = yaw
        k = 1 - exp(-dt / 0.4)
        self.rest = (self.rest[0] + (base[0] - self.rest[0]) * k, 0.0, self.rest[2] + (base[2] - self.rest[2]) * k)
        self._airborne(hips, base, yaw, dt)
        if self.air <= 0:
            if self.gait.walking:
                self._walk(base, yaw, velocity, speed, dt)
            else:
                self._stand(base, yaw, slow, pelvis_at[1], dt)
        return [self._solve(foot, hips[foot.index], pelvis, yaw) for foot in self.feet]

    def _plant(self, base: Vec, yaw: float, velocity: Vec, speed: float) -> None:
        for foot in self.feet:
            foot.ball = self.place(foot.index, base, yaw, TRACK, (0.0, 0.0, 0.0))
            foot.yaw, foot.pitch, foot.planted, foot.progress = yaw, 0.0, True, 0.0
        self.started = True

    def _reach(self, hips: list[Vec]) -> float:
        """Metres by which the higher-reaching foot could not touch the ground, standing straight on its toes."""
        return min(hips[0][1], hips[1][1]) - (self.limb[0].farthest + self.ankle[0][1] + self.tiptoe + self.sole)

    def _airborne(self, hips: list[Vec], base: Vec, yaw: float, dt: float) -> None:
        """In a jump the feet hang under the hips; they land where they are."""
        reach = self._reach(hips)
        self.slack, air = -reach, max(0.0, reach)
        if air <= 0 and self.air <= 0:
            return
        for foot in self.feet:
            target = self.place(foot.index, base, yaw, TRACK, (0.0, 0.0, 0.0))
            k = clamp(dt / 0.12, 0.0, 1.0)
            x, z = foot.ball[0] + (target[0] - foot.ball[0]) * k, foot.ball[2] + (target[2] - foot.ball[2]) * k
            foot.ball = (x, self.sole + air, z)
            foot.yaw = wrap(foot.yaw + wrap(yaw - foot.yaw) * k)
            foot.planted, foot.progress = air <= 0, 0.0
            foot.pitch = TIPTOE if air > 0 else foot.pitch
        self.air = air

    def start_walking(self, base: Vec, yaw: float, velocity: Vec, speed: float) -> None:
        """A recording that begins in mid-walk: put the feet where the phase has them."""
        duty = self.gait.duty(speed)
        stance = duty / self.gait.frequency
        for foot in self.feet:
            phase = (self.gait.phase + 0.5 * foot.index) % 1.0
            ahead = (0.5 - phase / duty) * stance
            if phase > duty:
                ahead = (_smooth((phase - duty) / (1 - duty)) - 0.5) * stance
            foot.ball = self.place(foot.index, base, yaw, 0.55, (velocity[0] * ahead, 0.0, velocity[2] * ahead))
            foot.planted = phase <= duty
            if not foot.planted:
                foot.by_gait, foot.from_phase, foot.progress = True, duty, (phase - duty) / (1 - duty)
                foot.start, foot.start_yaw, foot.start_pitch, foot.height = foot.ball, yaw, 0.6, 0.08 * self.size
                foot.start_from = _minus(foot.ball, base)

    # -- steps

    def _lift(self, foot: Foot, by_gait: bool, duration: float, height: float) -> None:
        foot.planted, foot.progress, foot.by_gait = False, 0.0, by_gait
        foot.start, foot.start_yaw, foot.start_pitch = foot.ball, foot.yaw, foot.pitch
        foot.duration, foot.height = duration, height

    def _swing(self, foot: Foot, target: Vec, yaw: float, progress: float) -> None:
        """Move a lifted foot: up first, then over, then down, so that it never slides."""
        s = clamp(progress, foot.progress, 1.0)
        foot.progress = s
        if s >= 1:
            foot.ball, foot.planted, foot.pitch = (foot.ball[0], self.sole, foot.ball[2]), True, 0.0
            return
        e = _smooth((s - 0.19) / 0.58)
        start = foot.start
        rise = foot.height * _bump(s)
        x, z = start[0] + (target[0] - start[0]) * e, start[2] + (target[2] - start[2]) * e
        if e >= 1:  # coming down: the place is chosen
            x, z = foot.ball[0], foot.ball[2]
        foot.ball = (x, self.sole + rise + (start[1] - self.sole) * _smooth(1 - 2 * s), z)
        foot.yaw = wrap(foot.start_yaw + wrap(yaw - foot.start_yaw) * e)
        foot.pitch = foot.start_pitch * _smooth(1 - s)

    def _walk(self, base: Vec, yaw: float, velocity: Vec, speed: float, dt: float) -> None:
        """Feet by the gait's phase. A swing is a curve relative to the moving body that meets the ground at rest."""
        gait = self.gait
        duty = gait.duty(speed)
        v = speed / gait.pace
        running = clamp((v - 1.6) / 0.6, 0.0, 1.0)
        height = self.size * (0.05 + 0.02 * v + running * 0.07 * (v - 1.6))
        stance, swing = duty / gait.frequency, (1 - duty) / gait.frequency
        ahead = 0.5 * stance + HOLD * swing
        back = -(0.06 + 0.18 * running) * self.size  # runners land under their mass
        late = 0.03 + 0.04 * running  # the ball lands after the heel, by this part of a stride
        for foot in self.feet:
            phase = (gait.phase - late + 0.5 * foot.index) % 1.0
            landing = self.place(foot.index, base, yaw, 0.55, (velocity[0] * ahead, 0.0, velocity[2] * ahead))
            landing = (landing[0] + back * sin(yaw), landing[1], landing[2] + back * cos(yaw))
            strained = foot.strained and self._helps(foot, landing, yaw)
            if foot.planted and strained and phase < 0.5 * duty:
                self._lift(foot, False, 0.5 * STEP_TIME, height)
            elif foot.planted and (strained or phase > duty) and phase < duty + 0.6 * (1 - duty):
                self._lift(foot, True, swing, height)
                foot.from_phase = min(phase, duty) if strained else duty
                k = HOLD * swing - max(phase - duty, 0.0) / gait.frequency  # until the foot leaves its place
                x, z = foot.ball[0] - base[0] - velocity[0] * k, foot.ball[2] - base[2] - velocity[2] * k
                foot.start_from = (x, 0.0, z)
            if foot.planted:
                # the heel leaves the ground late in stance
                heel = clamp((phase / duty - 0.6) / 0.4, 0.0, 1.0)
                foot.pitch = 0.7 * min(v / 1.3, 1.2) * heel * heel
            elif not foot.by_gait:
                self._swing(foot, landing, yaw, foot.progress + dt / foot.duration)
            else:
                began = foot.from_phase
                progress = (phase - began) / (1 - began) if phase >= began else 1.0
                self._carry(foot, landing, base, velocity, (1 - began) / gait.frequency, yaw, progress)

    def _carry(
        self, foot: Foot, landing: Vec, base: Vec, velocity: Vec, swing: float, yaw: float, progress: float
    ) -> None:
        """Move a foot of the gait's swing phase: cubic Hermite in the body's frame, both ends at rest in the world."""
        s = clamp(progress, foot.progress, 1.0)
        foot.progress = s
        u = clamp((s - HOLD) / (1 - 2 * HOLD), 0.0, 1.0)
        if u <= 0:
            x, z = foot.start[0], foot.start[2]
        elif u < 1:
            a, b = u * u * (3 - 2 * u), u * (1 - u) * (1 - 2 * u) * (1 - 2 * HOLD) * swing
            x = base[0] + foot.start_from[0] * (1 - a) + (landing[0] - base[0]) * a - velocity[0] * b
            z = base[2] + foot.start_from[2] * (1 - a) + (landing[2] - base[2]) * a - velocity[2] * b
        else:
            x, z = foot.ball[0], foot.ball[2]
        rise = foot.height * (_smooth(s / 0.3) if s < 0.5 else _smooth((1 - s) / 0.3))
        foot.ball = (x, self.sole + rise + (foot.start[1] - self.sole) * _smooth(1 - 2 * s), z)
        foot.yaw = wrap(foot.start_yaw + wrap(yaw - foot.start_yaw) * _smooth(u))
        foot.pitch = foot.start_pitch * _smooth(1 - s)
        if s >= 1:
            foot.ball, foot.planted, foot.pitch = (x, self.sole, z), True, 0.0

    def _stand(self, base: Vec, yaw: float, slow: Vec, low: float, dt: float) -> None:
        lead = (slow[0] * 0.4, 0.0, slow[2] * 0.4)
        base, yaw = self.rest, wrap(yaw + clamp(TURN_AHEAD * self.turning, -0.6, 0.6))
        # a lower pelvis goes with a wider stance
        track = TRACK * (1 + clamp(WIDEN * (self.height - low) / self.size, 0.0, 1.0))
        worst, asks = 0.0, None
        for foot in self.feet:
            target = self.place(foot.index, base, yaw, track, lead)
            if not foot.planted:
                if foot.by_gait:
                    foot.by_gait, foot.duration, foot.start = False, STEP_TIME, foot.ball
                    foot.progress = 0.4 if foot.progress < 0.6 else foot.progress
                self._swing(foot, target, yaw, foot.progress + dt / foot.duration)
                continue
            foot.pitch *= max(0.0, 1 - dt / 0.1)
            far = hypot(target[0] - foot.ball[0], target[2] - foot.ball[2]) / (STEP * self.size)
            turn = abs(wrap(yaw - foot.yaw)) / STEP_TURN
            need = max(far, turn)
            if need > worst:
                worst, asks = need, foot
        for foot in self.feet:
            if foot.planted and foot.strained:
                target = self.place(foot.index, base, yaw, track, lead)
                if self._helps(foot, target, yaw):
                    self._lift(foot, False, 0.5 * STEP_TIME, 0.05 * self.size)
        # who stands still for a while puts a foot that stands badly right
        calm = hypot(slow[0], slow[2]) < 0.08 and self.feet[0].planted and self.feet[1].planted
        self.calm = self.calm + dt if calm else 0.0
        enough = 1.0 if self.calm < SETTLE else 0.5
        if asks is not None and worst > enough and all(foot.planted for foot in self.feet):
            duration = STEP_TIME * clamp(1.3 - 0.2 * worst, 0.6, 1.0)
            self._lift(asks, False, duration, 0.05 * self.size)

    def _helps(self, foot: Foot, target: Vec, yaw: float) -> bool:
        """Would a step bring a foot that strains its leg to another place?"""
        far = hypot(target[0] - foot.ball[0], target[2] - foot.ball[2])
        return far > 0.06 * self.size or abs(wrap(yaw - foot.yaw)) > 0.25

    # -- inverse kinematics

    def _solve(self, foot: Foot, hip: Vec, pelvis: Quat, yaw: float) -> tuple[Quat, Quat, Quat]:
        limb = self.limb[foot.index]
        pitch, foot.strained = foot.pitch, False
        ankle = self._ankle(foot, pitch)
        if _distance(hip, ankle) > limb.farthest and pitch < TIPTOE:
            # a leg too short for the flat foot lifts the heel, as little as it must
            low, high = pitch, TIPTOE
            for _ in range(7):
                pitch = 0.5 * (low + high)
                ankle = self._ankle(foot, pitch)
                if _distance(hip, ankle) > limb.farthest:
                    low = pitch
                else:
                    high = pitch
            pitch = high
            ankle = self._ankle(foot, pitch)
            foot.strained = foot.planted and _distance(hip, ankle) > limb.farthest + 0.005
        elif _distance(hip, ankle) < limb.nearest:
            low, high = pitch, 1.4
            for _ in range(6):
                pitch = 0.5 * (low + high)
                ankle = self._ankle(foot, pitch)
                if _distance(hip, ankle) < limb.nearest:
                    low = pitch
                else:
                    high = pitch
        turn = wrap(foot.yaw - yaw)
        facing = yaw + 0.5 * turn
        ahead = rotate(pelvis, (0.0, 0.0, 1.0))
        pole = unit((sin(facing) + ahead[0], 0.5 * ahead[1], cos(facing) + ahead[2]), (sin(facing), 0.0, cos(facing)))
        # the knee bends outwards a little (hip abduction of a relaxed crouch)
        out = 0.12 if foot.index == 0 else -0.12
        pole = unit((pole[0] + out * cos(facing), pole[1], pole[2] - out * sin(facing)))
        thigh, knee, shin = two_bone(limb, hip, ankle, pole)
        for _ in range(3):
            # a deep crouch lifts the heel where the ankle bends no further
            lean = atan2(-(shin[0] * sin(foot.yaw) + shin[2] * cos(foot.yaw)), -shin[1])
            excess = lean - pitch - DORSIFLEXION
            if not 0.01 < excess < 1.5 or pitch > 1.2:
                break
            pitch += 0.7 * excess
            ankle = self._ankle(foot, pitch)
            thigh, knee, shin = two_bone(limb, hip, ankle, pole)
        return thigh, knee, mul(yaw_quat(foot.yaw), to_quat((pitch, 0.0, 0.0)))

    def _ankle(self, foot: Foot, pitch: float) -> Vec:
        x, y, z = self.ankle[foot.index]
        c, s = cos(pitch), sin(pitch)
        y, z = y * c - z * s, y * s + z * c
        c, s = cos(foot.yaw), sin(foot.yaw)
        bx, by, bz = foot.ball
        return (bx + x * c + z * s, by + y, bz - x * s + z * c)


def _smooth(s: float) -> float:
    """0 to 1 with minimum jerk (Flash & Hogan 1985)."""
    s = clamp(s, 0.0, 1.0)
    return s * s * s * (10 + s * (6 * s - 15))


def _bump(s: float) -> float:
    """Height profile of a swing: up before it goes over, down after; 1 at the top."""
    return _smooth(s / 0.42) if s < 0.5 else _smooth((1 - s) / 0.5)


def _plus(a: Vec, b: Vec) -> Vec:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vec, b: Vec) -> Vec:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _distance(a: Vec, b: Vec) -> float:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
