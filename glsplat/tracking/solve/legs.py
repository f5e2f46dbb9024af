"""Two legs of a pelvis, and the analytic solver's steps: planted until balance or gait asks; crouch, tiptoe, jump."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, exp, hypot, sin

from glsplat.tracking.solve.body import FEET, PELVIS, Body
from glsplat.tracking.solve.foot import HOLD, Foot
from glsplat.tracking.solve.gait import Gait
from glsplat.tracking.solve.leg import REFERENCE_LEG_M, SOFT, TIPTOE_RAD, Leg, LegPose
from glsplat.tracking.solve.quat import JointPose, Quat, Vec, add, clamp, pull, rotate, scale, sub, wrap
from glsplat.tracking.solve.tracked import AFLOAT_M, TrackedFoot

# lengths and speeds are those of a 1.7 m person
TAKE_OFF_M = 0.02  # below and above the reach of the tiptoes, over which a jump begins
USEFUL_STEP_M, USEFUL_TURN_RAD = 0.06, 0.25  # smaller steps and turns do not help a strained leg
STEP_M, STEP_TURN_RAD = 0.15, 0.45  # from where balance wants a foot, before it steps
WIDER = 2.0  # stance, for each metre that the pelvis is lower
SETTLED_AFTER_S = 0.6  # of standing still, after which half of STEP_M and STEP_TURN_RAD is too much
SETTLED_SPEED = 0.08  # m/s
TURN_AHEAD_S, MAX_TURN_AHEAD_RAD = 0.3, 0.6  # that a step looks ahead in a turn
LEAD_S = 0.4  # that a step looks ahead in a slow movement
STEP_S = 0.36  # of a step out of standing
QUICK_STEP_S = 0.2  # likewise, of a step that a strained leg needs
LIFT_M = 0.05  # height of a step
BALANCE_M = 0.05  # that the mass is before the ankles, from the rest pose (over the middle of the foot)
STILL_SPEED = 0.2  # m/s below which no leg is stretched unawares
FORESIGHT_S = 0.05  # a foot leaves the ground that long before its leg is stretched
STANCE_WIDTH, WALK_WIDTH = 1.0, 0.55  # of the rest pose's distance between the feet
MIDWALK_STEP_S = 0.2  # in which the feet of a recording that begins in mid-walk find their places
RUN_SPEED = 1.6  # m/s above which both feet may leave the ground in every stride
TURN_SMOOTHING_S, REST_SMOOTHING_S = 0.1, 0.4  # of the turning speed, of the base without its sway


class TwoLegs:
    """Legs, feet and trackers of feet of one body, over flat ground at y = 0."""

    def __init__(self, body: Body, soft: float = SOFT) -> None:
        self.sole: float = body.sole
        self.legs: tuple[Leg, Leg] = (Leg(body, 0, soft), Leg(body, 1, soft))
        self.length: float = self.legs[0].length
        self.size: float = self.length / REFERENCE_LEG_M  # 1 for a person of 1.7 m
        self.feet: tuple[Foot, Foot] = (Foot(0), Foot(1))
        self.tracked: tuple[TrackedFoot, TrackedFoot] = (TrackedFoot(self.legs[0]), TrackedFoot(self.legs[1]))
        _, up, back = self.legs[0].ankle
        self.tiptoe: float = up * cos(TIPTOE_RAD) - back * sin(TIPTOE_RAD) - up  # metres the ankle rises on tiptoe
        self._max_hip: float = self.legs[0].limb.farthest + up + self.tiptoe + self.sole  # height on tiptoe
        self.slack: float = 0.0  # metres left until the tiptoes lose the ground
        self.air: float = 0.0  # metres both feet are off the ground

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Forget the past; go on with another solver's ``feet``, if given."""
        self.slack = self.air = 0.0
        for tracked in self.tracked:
            tracked.reset()

    def hips(self, pelvis_at: Vec, pelvis: Quat) -> list[Vec]:
        """Return the positions of both hip joints."""
        return [add(pelvis_at, rotate(pelvis, leg.hip)) for leg in self.legs]

    def _follow(self, goals: Sequence[JointPose | None], knees: Sequence[Vec | None], dt: float) -> None:
        """Put tracked feet where they are."""
        for tracked, foot, goal, knee in zip(self.tracked, self.feet, goals, knees, strict=True):
            tracked.place(foot, goal, knee, dt)

    def _update_clearance(self, hips: Sequence[Vec]) -> None:
        """Update ``slack`` and ``air`` for these hips."""
        left, right = self.tracked[0].height, self.tracked[1].height
        reach = min(hips[0][1] - left, hips[1][1] - right) - self._max_hip
        self.slack = -reach
        if self.tracked[0].ankle is not None and self.tracked[1].ankle is not None:
            self.air = max(min(left, right) - AFLOAT_M, 0.0)
        elif reach < -TAKE_OFF_M:
            self.air = 0.0
        else:  # half a parabola from before the tiptoes lose the ground: the feet leave it without a jolt
            self.air = max(reach, (min(reach, TAKE_OFF_M) + TAKE_OFF_M) ** 2 / (4 * TAKE_OFF_M))

    def _free_feet(self) -> list[Foot]:
        """Return the feet that are not tracked."""
        return [foot for foot in self.feet if self.tracked[foot.index].ankle is None]


class Legs(TwoLegs):
    """Two legs under a pelvis."""

    def __init__(self, body: Body) -> None:
        super().__init__(body)
        self.height: float = body.joints[PELVIS][1] - body.ground
        forward = (0.0, 0.0, BALANCE_M * self.size)
        self.home: list[Vec] = [sub(sub(body.joints[foot], body.joints[PELVIS]), forward) for foot in FEET]
        self.gait: Gait = Gait(self.length)
        self.reset()

    def reset(self, feet: Sequence[Foot] | None = None) -> None:
        """Forget the past; the next update plants both feet under the pelvis, or goes on with ``feet``."""
        super().reset()
        self.gait.reset()
        self.first_feet = feet
        self.started = self.flying = False  # flying: in a jump
        self.calm = 0.0  # seconds of standing still
        self.yaw = self.turning = 0.0  # rad, rad/s of the heading
        self.rest: Vec = (0.0, 0.0, 0.0)  # the base without its sway

    def middle(self) -> tuple[float, float] | None:
        """Return world x, z of the rest pose's pelvis over the feet; None before the first update."""
        if not self.started:
            return None
        x = z = 0.0
        for foot in self.feet:
            back = self.home[foot.index][2]
            x += foot.x.at - back * sin(foot.turn.at)
            z += foot.z.at - back * cos(foot.turn.at)
        return 0.5 * x, 0.5 * z

    def place(self, index: int, base: Vec, yaw: float, width: float, lead: Vec = (0.0, 0.0, 0.0)) -> Vec:
        """Return where foot ``index`` should stand for a base with heading ``yaw``, ``lead`` ahead of it."""
        hx, _, hz = self.home[index]
        hx *= width
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
        goals: Sequence[JointPose | None] = (None, None),  # ankles and feet that are tracked
        knees: Sequence[Vec | None] = (None, None),
        shown: bool = True,
    ) -> list[LegPose]:
        """Return the left and the right leg.

        Nothing for legs that are not ``shown``: their feet are strained as when they were solved last.
        """
        hips = self.hips(pelvis_at, pelvis)
        if not self.started:
            self._start(base, yaw)
        self._follow(goals, knees, dt)
        k = 1 - exp(-dt / TURN_SMOOTHING_S)
        self.turning += (wrap(yaw - self.yaw) / max(dt, 1e-4) - self.turning) * k
        self.yaw = yaw
        self.rest = pull(self.rest, base, 1 - exp(-dt / REST_SMOOTHING_S))
        if speed > STILL_SPEED:
            for leg, foot, hip in zip(self.legs, self.feet, hips, strict=True):
                if foot.planted and not foot.strained and self.tracked[foot.index].ankle is None:
                    foot.strained = leg.strains(foot, add(hip, scale(velocity, FORESIGHT_S)), pelvis)
        self._update_clearance(hips)
        running = self.gait.walking and speed > RUN_SPEED * self.gait.pace
        free = self._free_feet()
        if not free:
            self.flying = False
        elif self.air > (0 if self.flying else TAKE_OFF_M) and not running:
            self._fly(free, base, yaw, dt)
        else:
            if self.flying:  # they land where they are
                for foot in free:
                    foot.land()
            self.flying = False
            if self.gait.walking:
                self._walk(free, base, yaw, velocity, speed, dt)
            else:
                self._stand(free, yaw, slow, speed, pelvis_at[1], dt)
        if not shown:
            return []
        return [
            tracked.solve(foot, hip, pelvis, yaw) or tracked.leg.solve(foot, hip, pelvis, yaw)
            for tracked, foot, hip in zip(self.tracked, self.feet, hips, strict=True)
        ]

    def _start(self, base: Vec, yaw: float) -> None:
        for foot in self.feet:
            if self.first_feet is None:
                foot.plant(self.place(foot.index, base, yaw, STANCE_WIDTH), yaw)
            else:
                foot.take_over(self.first_feet[foot.index], QUICK_STEP_S, LIFT_M * self.size)
        self.rest, self.yaw, self.turning, self.started = base, yaw, 0.0, True

    def _fly(self, free: Sequence[Foot], base: Vec, yaw: float, dt: float) -> None:
        """Let the feet hang under the hips in a jump."""
        self.flying, off = True, self.air > TAKE_OFF_M
        for foot in free:
            foot.planted, foot.left = False, 0.0
            x, _, z = self.place(foot.index, base, yaw, STANCE_WIDTH) if off else foot.ball
            pitch = TIPTOE_RAD if off else foot.tilt.at
            foot.hang((x, self.sole + self.air, z), yaw if off else foot.yaw, pitch, dt)

    def start_walking(self, speed: float) -> None:
        """Begin a recording in mid-walk: the feet hurry to where the phase has them."""
        duty = self.gait.duty(speed)
        for foot in self._free_feet():
            phase = (self.gait.phase + 0.5 * foot.index) % 1.0
            left = (1 - phase) / self.gait.frequency
            by_gait = phase > duty and left > MIDWALK_STEP_S
            foot.lift(left if by_gait else MIDWALK_STEP_S, LIFT_M * self.size, by_gait)

    def _walk(self, free: Sequence[Foot], base: Vec, yaw: float, velocity: Vec, speed: float, dt: float) -> None:
        """Move the feet by the gait's phase."""
        gait = self.gait
        duty = gait.duty(speed)
        v = speed / gait.pace
        running = clamp((v - RUN_SPEED) / 0.6, 0.0, 1.0)
        height = self.size * (LIFT_M + 0.02 * v + running * 0.07 * (v - RUN_SPEED))
        stance, swing = duty / gait.frequency, (1 - duty) / gait.frequency  # seconds
        ahead = 0.5 * stance + HOLD * swing
        back = -(0.06 + 0.18 * running) * self.size  # runners land under their mass
        late = 0.03 + 0.04 * running  # the ball lands after the heel, by this part of a stride

        def landing(foot: Foot, ahead: float) -> Vec:
            """Return the landing position of a foot that the body passes half a stance later."""
            lead = (velocity[0] * ahead, 0.0, velocity[2] * ahead)
            x, y, z = self.place(foot.index, base, yaw, WALK_WIDTH, lead)
            return (x + back * sin(yaw), y, z + back * cos(yaw))

        for foot in free:
            phase = (gait.phase - late + 0.5 * foot.index) % 1.0
            left = (1 - phase) / gait.frequency  # seconds until the foot is due on the ground
            if foot.planted:
                strained = foot.strained and self._helps(foot, landing(foot, ahead))
                if strained and phase < 0.5 * duty:
                    foot.lift(QUICK_STEP_S, height, False)
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
            foot.swing(landing(foot, ahead - down * stance / duty + over), yaw, left, speed, dt)

    def _stand(self, free: Sequence[Foot], yaw: float, slow: Vec, speed: float, height: float, dt: float) -> None:
        """Keep the feet planted; step with the one that is furthest from where balance wants it."""
        lead = (slow[0] * LEAD_S, 0.0, slow[2] * LEAD_S)
        yaw = wrap(yaw + clamp(TURN_AHEAD_S * self.turning, -MAX_TURN_AHEAD_RAD, MAX_TURN_AHEAD_RAD))
        # a lower pelvis goes with a wider stance
        width = STANCE_WIDTH * (1 + clamp(WIDER * (self.height - height) / self.size, 0.0, 1.0))
        worst, worst_foot = 0.0, None
        for foot in free:
            target = self.place(foot.index, self.rest, yaw, width, lead)
            if not foot.planted:
                foot.swing(target, yaw, foot.left - dt, speed, dt)
                continue
            foot.stand(self.sole + self.air, 0.0, dt)
            if foot.strained and self._helps(foot, target):
                foot.lift(QUICK_STEP_S, LIFT_M * self.size, False)
                continue
            far = hypot(target[0] - foot.x.at, target[2] - foot.z.at) / (STEP_M * self.size)
            need = max(far, abs(wrap(yaw - foot.yaw)) / STEP_TURN_RAD)
            if need > worst:
                worst, worst_foot = need, foot
        # a user who stands still for a while corrects a foot that stands badly
        both = self.feet[0].planted and self.feet[1].planted
        calm = both and hypot(slow[0], slow[2]) < SETTLED_SPEED
        self.calm = self.calm + dt if calm else 0.0
        if worst_foot is not None and both and worst > (1.0 if self.calm < SETTLED_AFTER_S else 0.5):
            worst_foot.lift(STEP_S * clamp(1.3 - 0.2 * worst, 0.6, 1.0), LIFT_M * self.size, False)

    def _helps(self, foot: Foot, target: Vec) -> bool:
        """Return whether a step brings a foot that strains its leg to another place."""
        far = hypot(target[0] - foot.x.at, target[2] - foot.z.at)
        return far > USEFUL_STEP_M * self.size or abs(wrap(self.yaw - foot.yaw)) > USEFUL_TURN_RAD
