"""Feet that follow the network's hints and still stand: planted without sliding, lifted and set down in one motion."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot, sqrt

from glsplat.extras.learned.hints import FootHint
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, length, pull, rotate, scale, sub, wrap, yaw_quat
from glsplat.tracking.solve.stepping.clearance import Clearance
from glsplat.tracking.solve.stepping.foot import Foot
from glsplat.tracking.solve.stepping.leg import TIPTOE, Leg
from glsplat.tracking.solve.tracked import Follow

__all__ = ["Feet", "Rest"]

LIFT, DROP = 0.55, 0.75  # of a foot's standing: below, it is lifted; above, it is set down; at most this share ...
AMONG = (0.5, 0.75)  # ... of the way from the least to the most it was lately: a network in doubt says neither 0 nor 1
LATELY = 0.8  # seconds
MOVES = 0.35  # m/s, or
FAR = 0.07  # metres, that a goal must be away before a foot is lifted for it
LOST = 0.16  # metres a planted foot is at most from its goal (of a 1.7 m person)
TURNED = 0.6  # radians likewise
FOLLOW = 0.15  # seconds: of the low pass by which a lifted foot follows its goal
UP = 0.09  # seconds: likewise, upwards
SURGE = 0.15  # metres it is at most told to rise at once; in a jump it hangs
OFF = 0.45  # of CLEAR that a foot is up when it moves over as fast as it may
RISE = 0.05  # seconds: likewise, upwards where its leg does not reach
FORESIGHT = 0.08  # seconds: a foot leaves the ground before its leg is stretched
LEAD = 0.065  # seconds that this is behind
BRIEFEST = 0.14  # seconds a foot is in the air at least
SET = 0.18  # seconds in which it is set down, and of these
OVER = 0.07  # seconds in which it only goes down
REST = 0.18  # seconds it then stands at least
SLOW, CALM = 0.2, 0.6  # m/s, seconds: slower for longer is standing, where it is not
STEP_UP = 0.2  # metres or more over the ground
CLEAR = 0.045  # metres the ball is over the ground while it moves
HELPS = 0.06  # metres or more by which a step must help a strained leg
DRAGS = 0.1  # metres from below its hip that a foot is dragged at by a leg that does not reach it
RESTS, RESTED = (0.04, 0.3), 0.4  # metres, radians, seconds: who keeps the head as still as that takes no step
ASTRIDE = 0.3  # of its length that a leg's foot is from below the hip, beyond which a strained leg steps at once
SOFT = 0.05  # of its length over which a leg becomes straight: knees of feet that follow a guess tremble more
BENDS = 0.06  # seconds: of the low pass of where knees bend to
HEEL = 0.5  # of its rise on tiptoes that an ankle may have where a foot is put down
REACH = 0.985  # of its length to which a lifted foot is put


BEHIND, CATCH, MOST = 0.8, 1.0, 0.15  # seconds, gain, metres: how feet that are behind their hints catch up


class Rest:
    """Whether a head rests: it has not left a small ball, nor turned far, for a while."""

    def __init__(self, size: float) -> None:
        self.size = size
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._at: Vec | None = None
        self._yaw = self._for = 0.0

    def update(self, eye: Vec, yaw: float, dt: float) -> bool:
        """Whether it rests at this moment."""
        near, turned = RESTS
        if self._at is None or length(sub(eye, self._at)) > near * self.size or abs(wrap(yaw - self._yaw)) > turned:
            self._at, self._yaw, self._for = eye, yaw, 0.0
        self._for += dt
        return self._for > RESTED


class Feet:
    """Two feet on flat ground at y = 0 under a pelvis."""

    def __init__(self, body: Body) -> None:
        self.sole: float = body.sole
        self.legs: tuple[Leg, Leg] = (Leg(body, 0, SOFT), Leg(body, 1, SOFT))
        self.size: float = self.legs[0].length / 0.83
        self.clearance: Clearance = Clearance(self.legs[0], self.sole)
        self.feet: tuple[Foot, Foot] = (Foot(0), Foot(1))
        self.follow: tuple[Follow, Follow] = (Follow(self.legs[0]), Follow(self.legs[1]))
        self.reset()

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Forget the past: the next update puts both feet where the hints say, or goes on with these."""
        self.started: bool = feet is not None
        for foot, other in zip(self.feet, feet or (), strict=feet is not None):
            foot.take_over(other, 0.0, CLEAR * self.size)
        for follow in self.follow:
            follow.reset()
        self.air = self.slack = 0.0
        self._before: Vec | None = None
        self._speed: Vec = (0.0, 0.0, 0.0)  # m/s of the pelvis
        self._behind: Vec = (0.0, 0.0, 0.0)  # metres that feet have lately been behind their hints
        self._ahead: Vec = (0.0, 0.0, 0.0)  # metres that they land further on for it
        self._bends: list[Vec | None] = [None, None]  # where knees are aside of the legs' middles, from the pelvis
        self._calm = [0.0, 0.0]  # seconds for which each goal has been all but still
        self._since = [1.0, 1.0]  # seconds since each foot was lifted or set down
        self._least, self._most = [0.0, 0.0], [1.0, 1.0]  # each foot's standing, lately

    def update(
        self,
        hints: Sequence[FootHint],
        pelvis_at: Vec,
        pelvis: Quat,
        yaw: float,
        dt: float,
        goals: Sequence[tuple[Vec, Quat] | None] = (None, None),  # ankles and feet that are tracked
        knees: Sequence[Vec | None] = (None, None),
        rests: bool = False,  # the head is still: a foot is lifted only where its leg does not reach
    ) -> list[tuple[Quat, Quat, Quat]]:
        """World rotation of thigh, local rotation of the knee, and world rotation of the foot, for left and right."""
        hips = [add(pelvis_at, rotate(pelvis, leg.hip)) for leg in self.legs]
        if not self.started:
            self.started = True
            for foot, hint in zip(self.feet, hints, strict=True):
                x, y, z = hint.ball
                foot.plant((x, self.sole, z), hint.yaw)
                if hint.stands < 0.5:
                    foot.y.put(max(y, self.sole + CLEAR * self.size))
                    foot.planted = False
        if self._before is not None:
            k = 1 - exp(-dt / 0.04)
            self._speed = pull(self._speed, scale(sub(pelvis_at, self._before), 1 / dt), k)
        self._before = pelvis_at
        for follow, foot, goal, knee in zip(self.follow, self.feet, goals, knees, strict=True):
            follow.place(foot, goal, knee, dt)
        self.slack, self.air = self.clearance.of(hips, self.follow)
        self._catch_up(hints, dt)
        limbs = []
        for foot, hint, hip, leg in zip(self.feet, hints, hips, self.legs, strict=True):
            tracked = self.follow[foot.index].solve(foot, hip, pelvis, yaw)
            if tracked is not None:
                limbs.append(tracked)
                continue
            self._since[foot.index] += dt
            lift, drop = self._bounds(foot.index, hint.stands, dt)
            slow = hypot(hint.speed[0], hint.speed[2]) * hint.sure < SLOW
            self._calm[foot.index] = self._calm[foot.index] + dt if slow else 0.0
            if foot.planted and self._leaves(foot, hint, leg, hip, pelvis, lift, rests):
                foot.planted, foot.left = False, 0.0
                self._since[foot.index] = self._calm[foot.index] = 0.0
            if foot.planted:
                foot.stand(self.sole + self.air, clamp(hint.pitch, 0.0, TIPTOE) if hint.pitch > 0.12 else 0.0, dt)
            else:
                self._swing(foot, hint, leg, hip, drop, dt)
            middle = scale(add(hip, leg.above(foot, foot.tilt.at)), 0.5)
            bends = rotate(yaw_quat(-yaw), sub(hint.knee, middle))
            bends = self._bends[foot.index] = pull(self._bends[foot.index] or bends, bends, 1 - exp(-dt / BENDS))
            limbs.append(leg.solve(foot, hip, pelvis, yaw, rotate(yaw_quat(yaw), bends)))
        return limbs

    def _catch_up(self, hints: Sequence[FootHint], dt: float) -> None:
        """Feet of a network in doubt, which hedges, come down too early: they are behind their hints all the time."""
        k = 1 - exp(-dt / BEHIND)
        for foot, hint in zip(self.feet, hints, strict=True):
            self._behind = pull(self._behind, sub(hint.ball, foot.ball), 0.5 * k)
        vx, _, vz = self._speed
        pace = hypot(vx, vz)
        along = (self._behind[0] * vx + self._behind[2] * vz) / max(pace, 1e-6)
        metres = clamp(CATCH * along, 0.0, MOST * self.size) * clamp((pace / self.size - 0.3) / 0.4, 0.0, 1.0)
        self._ahead = (vx / max(pace, 1e-6) * metres, 0.0, vz / max(pace, 1e-6) * metres)

    def _bounds(self, side: int, stands: float, dt: float) -> tuple[float, float]:
        """Of a foot's standing: below the first it is lifted, above the second set down."""
        k = 1 - exp(-dt / LATELY)
        self._least[side] = least = min(stands, self._least[side] + (stands - self._least[side]) * k)
        self._most[side] = most = max(stands, self._most[side] + (stands - self._most[side]) * k)
        low, high = [least + share * (most - least) for share in AMONG]
        return min(LIFT, low), min(DROP, high)

    def _leaves(self, foot: Foot, hint: FootHint, leg: Leg, hip: Vec, pelvis: Quat, lift: float, rests: bool) -> bool:
        """Whether a planted foot should be lifted."""
        if foot.strained and self._since[foot.index] > 0.04 and hypot(hip[0] - foot.x.at, hip[2] - foot.z.at) > DRAGS:
            return True
        ahead = add(hip, scale(self._speed, FORESIGHT))
        strained = foot.strained or leg.strains(foot, ahead, pelvis)
        if (
            strained
            and self._since[foot.index] > 0.04
            and hypot(ahead[0] - foot.x.at, ahead[2] - foot.z.at) > ASTRIDE * leg.length
        ):
            return True
        if self._since[foot.index] < REST or (rests and not strained):
            return False
        away = hypot(hint.ball[0] - foot.x.at, hint.ball[2] - foot.z.at) / self.size
        moves = hypot(hint.speed[0], hint.speed[2]) / self.size
        if hint.stands < lift and (away > FAR or moves > MOVES):
            return True
        turned = abs(wrap(hint.yaw - foot.yaw))
        other = self.feet[1 - foot.index]
        if (away > LOST or turned > TURNED) and (other.planted or away > 2 * LOST):
            return True
        return strained and (away > HELPS or turned > 0.25)

    def _swing(self, foot: Foot, hint: FootHint, leg: Leg, hip: Vec, drop: float, dt: float) -> None:
        """A lifted foot follows its goal; where the goal stands, it is set down there and moves over no more."""
        ground = self.sole + self.air
        # whatever the network says of it: a foot that goes nowhere just over the ground stands
        calm = self._calm[foot.index] > CALM and hint.ball[1] < ground + STEP_UP * self.size
        if foot.left <= 0 and self._since[foot.index] > BRIEFEST and (hint.stands > drop or calm):
            foot.left = SET
            lead = SET - OVER
            landing = add(add(hint.ball, self._ahead), scale(hint.speed, 0.5 * lead * (1 - hint.stands)))
            foot.landing = self._within(landing, leg, add(hip, scale(self._speed, SET)), ground)
        if foot.left > 0:
            foot.left -= dt
            over = foot.left - OVER
            if over + dt > 0:
                foot.x.approach(foot.landing[0], over + dt, dt)
                foot.z.approach(foot.landing[2], over + dt, dt)
                foot.turn.approach(foot.turn.at + wrap(hint.yaw - foot.turn.at), over + dt, dt)
            foot.y.approach(ground, foot.left + dt, dt)
            foot.tilt.approach(0.0, foot.left + dt, dt)
            astride = hypot(hip[0] - foot.x.at, hip[2] - foot.z.at) > ASTRIDE * leg.length
            if foot.strained and astride:  # the body has gone on: another step
                foot.left = 0.0
                self._since[foot.index] = 0.0
                return
            if foot.left <= 0:
                foot.land()
                self._since[foot.index] = 0.0
            return
        least = ground + CLEAR * self.size
        high = clamp(hint.ball[1], least, max(least, foot.y.at + SURGE * self.size)) if self.air <= 0 else least
        goal = self._within(add(add(hint.ball, self._ahead), scale(hint.speed, LEAD)), leg, hip, high)
        # up before it moves over
        rises = clamp((foot.y.at - ground) / (OFF * CLEAR * self.size), 0.05, 1.0)
        follow = FOLLOW / rises
        foot.x.approach(goal[0], follow, dt)
        foot.z.approach(goal[2], follow, dt)
        foot.y.approach(high, RISE if foot.strained else UP, dt)
        foot.turn.approach(foot.turn.at + wrap(hint.yaw - foot.turn.at), FOLLOW, dt)
        foot.tilt.approach(clamp(hint.pitch, -0.3, TIPTOE), FOLLOW, dt)

    def _within(self, place: Vec, leg: Leg, hip: Vec, high: float) -> Vec:
        """A place for the ball at this height that the leg can reach: nearer to below the hip, if it must be."""
        rise = hip[1] - (high + leg.ankle[1] + HEEL * self.clearance.tiptoe)
        most = sqrt(max((REACH * leg.limb.farthest) ** 2 - rise * rise, 0.0)) if rise > 0 else leg.limb.farthest
        x, z = place[0] - hip[0], place[2] - hip[2]
        far = hypot(x, z)
        k = 1.0 if far <= most else most / far
        return (hip[0] + x * k, place[1], hip[2] + z * k)
