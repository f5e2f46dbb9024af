"""Feet that follow the network's hints without sliding: each is planted, lifted, and set down in one motion."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot, inf, sqrt

from glsplat.extras.learned.hints import FootHint
from glsplat.extras.learned.posture import Velocity
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.leg import TIPTOE_RAD, Leg, LegPose
from glsplat.tracking.solve.legs import USEFUL_STEP_M, USEFUL_TURN_RAD, TwoLegs
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, pull, rotate, scale, sub, wrap

# lengths are those of a person of 1.7 m
LIFT_BELOW, DROP_ABOVE = 0.55, 0.75  # stance of a foot: below, it is lifted; above, it is set down; at most ...
LIFT_SHARE, DROP_SHARE = 0.5, 0.75  # ... this part of its recent range, as an unsure network avoids 0 and 1
RANGE_SMOOTHING_S = 0.8  # of that range
GOAL_SPEED, GOAL_FAR_M = 0.35, 0.07  # least m/s or metres of a goal that lift a foot
MAX_PLANTED_ERROR_M, MAX_PLANTED_TURN_RAD = 0.16, 0.6  # from a planted foot to its goal
TURNED_RAD, SETTLED_S, SETTLING_S = 0.3, 0.6, 4.0  # a turn; 0.6 s after it, for 4 s, half these errors lift a foot
SWING_S, SWING_UP_S = 0.15, 0.09  # time constants of a lifted foot towards its goal, and of its height
STRAINED_UP_S = 0.05  # time constant upwards if its leg does not reach
MAX_SURGE_M = 0.15  # greatest rise at once; in a jump a foot hangs
FREE_HEIGHT = 0.45  # of CLEARANCE_M, from which a foot moves sideways at full speed
FORESIGHT_S = 0.08  # time before its leg is stretched at which a foot is lifted
LEAD_S = 0.065  # lag of a swing, which is compensated
MIN_SWING_S = 0.14
SET_DOWN_S, VERTICAL_S = 0.18, 0.07  # duration of setting a foot down, and of its vertical end
MIN_STANCE_S = 0.18
STRAIN_PATIENCE_S = 0.04  # after a foot was lifted or set down, before its strained leg lifts it
CALM_SPEED, CALM_S = 0.2, 0.6  # m/s, seconds: a slower goal stands after that time
STEP_UP_M = 0.2  # height of a goal over the ground from which it is on an object
CLEARANCE_M = 0.045  # of the ball over the ground while it moves
MIN_DRAG_M = 0.1  # horizontal distance from its hip at which an unreachable foot is lifted
ASTRIDE = 0.3  # horizontal distance from its hip, in lengths of the leg, at which a strained leg steps at once
SOFT = 0.05  # of its length over which a leg becomes straight: knees above estimated feet tremble more
KNEE_SMOOTHING_S = 0.06
LANDING_HEEL = 0.5  # of its rise on tiptoes that an ankle may have where a foot is set down
MAX_REACH = 0.985  # of its length that a leg with a lifted foot has at most
LAG_SMOOTHING_S, CATCH_UP_GAIN, MAX_CATCH_UP_M = 0.8, 1.0, 0.15  # how feet that lag behind their hints catch up
PELVIS_SPEED_SMOOTHING_S = 0.04


class Feet(TwoLegs):
    """Two feet under a pelvis."""

    def __init__(self, body: Body) -> None:
        super().__init__(body, SOFT)
        self._velocity = Velocity(PELVIS_SPEED_SMOOTHING_S)  # of the pelvis
        self.reset()

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Reset the state; the next update puts both feet at the hints, or continues with ``feet``."""
        super().reset()
        self.started: bool = feet is not None
        for foot, other in zip(self.feet, feet or (), strict=feet is not None):
            foot.take_over(other, 0.0, CLEARANCE_M * self.size)
        self._velocity.reset()
        self._lag: Vec = (0.0, 0.0, 0.0)  # recent lag of the feet behind their hints, metres
        self._catch_up: Vec = (0.0, 0.0, 0.0)  # its compensation where they land, metres
        self._knees: list[Vec | None] = [None, None]  # from the legs' middles, in the pelvis' heading
        self._calm_s = [0.0, 0.0]  # time for which each goal has been almost still
        self._turned_to, self._turned_s = 0.0, inf  # the heading after the last turn, and the time since
        self._since_s = [1.0, 1.0]  # since each foot was lifted or set down
        self._min_stance, self._max_stance = [0.0, 0.0], [1.0, 1.0]  # each foot's recent range

    def update(
        self,
        hints: Sequence[FootHint],
        pelvis_at: Vec,
        pelvis: Quat,
        yaw: float,
        dt: float,
        goals: Sequence[quat.JointPose | None] = (None, None),  # tracked ankles and feet
        knees: Sequence[Vec | None] = (None, None),
        rests: bool = False,  # the head is still: only a leg that does not reach lifts its foot
    ) -> list[LegPose]:
        """Return the left and the right leg."""
        hips = self.hips(pelvis_at, pelvis)
        if not self.started:
            self.started, self._turned_to = True, yaw
            for foot, hint in zip(self.feet, hints, strict=True):
                x, y, z = hint.ball
                foot.plant((x, self.sole, z), hint.yaw)
                if hint.stance < 0.5:
                    foot.y.put(max(y, self.sole + CLEARANCE_M * self.size))
                    foot.planted = False
        self._velocity.update(pelvis_at, dt)
        self._follow(goals, knees, dt)
        self._update_clearance(hips)
        self._update_catch_up(hints, dt)
        settles = self._settles(yaw, dt) and rests
        limbs = []
        for foot, hint, hip, leg in zip(self.feet, hints, hips, self.legs, strict=True):
            tracked = self.tracked[foot.index].solve(foot, hip, pelvis, yaw)
            if tracked is not None:
                limbs.append(tracked)
                continue
            self._since_s[foot.index] += dt
            lift, drop = self._thresholds(foot.index, hint.stance, dt)
            slow = hypot(hint.speed[0], hint.speed[2]) * hint.confidence < CALM_SPEED
            self._calm_s[foot.index] = self._calm_s[foot.index] + dt if slow else 0.0
            if foot.planted and self._leaves(foot, hint, leg, hip, pelvis, lift, rests, settles):
                foot.planted, foot.left = False, 0.0
                self._since_s[foot.index] = self._calm_s[foot.index] = 0.0
            if foot.planted:
                foot.stand(self.sole + self.air, clamp(hint.pitch, 0.0, TIPTOE_RAD) if hint.pitch > 0.12 else 0.0, dt)
            else:
                self._swing(foot, hint, leg, hip, drop, dt)
            middle = scale(add(hip, leg.above(foot, foot.tilt.at)), 0.5)
            knee = rotate(quat.yaw_quat(-yaw), sub(hint.knee, middle))
            knee = pull(self._knees[foot.index] or knee, knee, 1 - exp(-dt / KNEE_SMOOTHING_S))
            self._knees[foot.index] = knee
            limbs.append(leg.solve(foot, hip, pelvis, yaw, rotate(quat.yaw_quat(yaw), knee)))
        return limbs

    def _update_catch_up(self, hints: Sequence[FootHint], dt: float) -> None:
        """Let feet land further on, as those of an unsure network land early and lag behind their hints."""
        k = 1 - exp(-dt / LAG_SMOOTHING_S)
        for foot, hint in zip(self.feet, hints, strict=True):
            self._lag = pull(self._lag, sub(hint.ball, foot.ball), 0.5 * k)
        vx, _, vz = self._velocity.value
        pace = hypot(vx, vz)
        along = (self._lag[0] * vx + self._lag[2] * vz) / max(pace, 1e-6)
        metres = clamp(CATCH_UP_GAIN * along, 0.0, MAX_CATCH_UP_M * self.size) * clamp(
            (pace / self.size - 0.3) / 0.4, 0.0, 1.0
        )
        self._catch_up = (vx / max(pace, 1e-6) * metres, 0.0, vz / max(pace, 1e-6) * metres)

    def _settles(self, yaw: float, dt: float) -> bool:
        """Return whether badly placed feet are corrected now: a while after a turn on the spot."""
        self._turned_s += dt
        if abs(wrap(yaw - self._turned_to)) > TURNED_RAD:
            self._turned_to, self._turned_s = yaw, 0.0
        return SETTLED_S < self._turned_s < SETTLED_S + SETTLING_S

    def _thresholds(self, side: int, stance: float, dt: float) -> tuple[float, float]:
        """Return the stance below which a foot is lifted, and that above which it is set down."""
        k = 1 - exp(-dt / RANGE_SMOOTHING_S)
        least = min(stance, self._min_stance[side] + (stance - self._min_stance[side]) * k)
        most = max(stance, self._max_stance[side] + (stance - self._max_stance[side]) * k)
        self._min_stance[side], self._max_stance[side] = least, most
        lift, drop = least + LIFT_SHARE * (most - least), least + DROP_SHARE * (most - least)
        return min(LIFT_BELOW, lift), min(DROP_ABOVE, drop)

    def _leaves(
        self, foot: Foot, hint: FootHint, leg: Leg, hip: Vec, pelvis: Quat, lift: float, rests: bool, settles: bool
    ) -> bool:
        """Return whether a planted foot should be lifted."""
        patient = self._since_s[foot.index] > STRAIN_PATIENCE_S
        if foot.strained and patient and hypot(hip[0] - foot.x.at, hip[2] - foot.z.at) > MIN_DRAG_M:
            return True
        ahead = add(hip, scale(self._velocity.value, FORESIGHT_S))
        strained = foot.strained or leg.strains(foot, ahead, pelvis)
        astride = hypot(ahead[0] - foot.x.at, ahead[2] - foot.z.at) > ASTRIDE * leg.length
        if strained and patient and astride:
            return True
        if self._since_s[foot.index] < MIN_STANCE_S or (rests and not strained and not settles):
            return False
        away = hypot(hint.ball[0] - foot.x.at, hint.ball[2] - foot.z.at) / self.size
        moves = hypot(hint.speed[0], hint.speed[2]) / self.size
        if not settles and hint.stance < lift and (away > GOAL_FAR_M or moves > GOAL_SPEED):
            return True
        turned = abs(wrap(hint.yaw - foot.yaw))
        other = self.feet[1 - foot.index]
        need = max(away / MAX_PLANTED_ERROR_M, turned / MAX_PLANTED_TURN_RAD)
        if need > (0.5 if settles else 1.0) and (other.planted or away > 2 * MAX_PLANTED_ERROR_M):
            return True
        return strained and (away > USEFUL_STEP_M or turned > USEFUL_TURN_RAD)

    def _swing(self, foot: Foot, hint: FootHint, leg: Leg, hip: Vec, drop: float, dt: float) -> None:
        """Move a lifted foot to its goal; set it down once the goal stands."""
        ground = self.sole + self.air
        # a still goal just over the ground stands, whatever its stance
        calm = self._calm_s[foot.index] > CALM_S and hint.ball[1] < ground + STEP_UP_M * self.size
        if foot.left <= 0 and self._since_s[foot.index] > MIN_SWING_S and (hint.stance > drop or calm):
            foot.left = SET_DOWN_S
            lead = SET_DOWN_S - VERTICAL_S
            landing = add(add(hint.ball, self._catch_up), scale(hint.speed, 0.5 * lead * (1 - hint.stance)))
            foot.landing = self._within(landing, leg, add(hip, scale(self._velocity.value, SET_DOWN_S)), ground)
        if foot.left > 0:
            foot.left -= dt
            over = foot.left - VERTICAL_S
            if over + dt > 0:
                foot.x.approach(foot.landing[0], over + dt, dt)
                foot.z.approach(foot.landing[2], over + dt, dt)
                foot.turn.approach(foot.turn.at + wrap(hint.yaw - foot.turn.at), over + dt, dt)
            foot.y.approach(ground, foot.left + dt, dt)
            foot.tilt.approach(0.0, foot.left + dt, dt)
            astride = hypot(hip[0] - foot.x.at, hip[2] - foot.z.at) > ASTRIDE * leg.length
            if foot.strained and astride:  # the body has moved on: another step
                foot.left = 0.0
                self._since_s[foot.index] = 0.0
                return
            if foot.left <= 0:
                foot.land()
                self._since_s[foot.index] = 0.0
            return
        least = ground + CLEARANCE_M * self.size
        high = clamp(hint.ball[1], least, max(least, foot.y.at + MAX_SURGE_M * self.size)) if self.air <= 0 else least
        goal = self._within(add(add(hint.ball, self._catch_up), scale(hint.speed, LEAD_S)), leg, hip, high)
        # up before it moves sideways
        rises = clamp((foot.y.at - ground) / (FREE_HEIGHT * CLEARANCE_M * self.size), 0.05, 1.0)
        follow = SWING_S / rises
        foot.x.approach(goal[0], follow, dt)
        foot.z.approach(goal[2], follow, dt)
        foot.y.approach(high, STRAINED_UP_S if foot.strained else SWING_UP_S, dt)
        foot.turn.approach(foot.turn.at + wrap(hint.yaw - foot.turn.at), SWING_S, dt)
        foot.tilt.approach(clamp(hint.pitch, -0.3, TIPTOE_RAD), SWING_S, dt)

    def _within(self, place: Vec, leg: Leg, hip: Vec, high: float) -> Vec:
        """Limit the ball's position at this height to the leg's reach, towards the point below the hip."""
        rise = hip[1] - (high + leg.ankle[1] + LANDING_HEEL * self.tiptoe)
        most = sqrt(max((MAX_REACH * leg.limb.farthest) ** 2 - rise * rise, 0.0)) if rise > 0 else leg.limb.farthest
        x, z = place[0] - hip[0], place[2] - hip[2]
        far = hypot(x, z)
        k = 1.0 if far <= most else most / far
        return (hip[0] + x * k, place[1], hip[2] + z * k)
