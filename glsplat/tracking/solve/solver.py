"""The analytic solver: head to pelvis, hands through the arms, feet by balance and gait; what is tracked as tracked."""

from __future__ import annotations

from math import exp, hypot
from typing import ClassVar

from glsplat.tracking.solve.arms import Arm
from glsplat.tracking.solve.body import NECK, PELVIS, Body
from glsplat.tracking.solve.hands import Hands
from glsplat.tracking.solve.heading import Heading
from glsplat.tracking.solve.height_limit import HeightLimit
from glsplat.tracking.solve.quat import Vec, clamp, rotate, yaw_quat
from glsplat.tracking.solve.solution import Limb, Solution, Targets, assembled, reaching
from glsplat.tracking.solve.spine import Spine, Torso
from glsplat.tracking.solve.stepping.legs import Legs
from glsplat.tracking.solve.tracked import Pelvis

__all__ = ["AnalyticSolver"]

TWIST = 0.2  # of the yaw that both hands suggest by which the chest turns further than the pelvis
SLOW = 0.125  # seconds; twice that scores worse on motion capture (docs/tracking.md)


class AnalyticSolver:
    """Head to pelvis through the spine, hands through the arms, feet by balance and gait: closed forms, no training."""

    keeps_limits: ClassVar[bool] = True  # rotations are within the joints' limits

    def __init__(self, body: Body) -> None:
        self.body = body
        self.ground: HeightLimit = HeightLimit(body.eye_height)
        self.heading: Heading = Heading()
        self.spine: Spine = Spine(body)
        self.pelvis: Pelvis = Pelvis()
        self.legs: Legs = Legs(body)
        self.arms: tuple[Arm, Arm] = (Arm(body, 0), Arm(body, 1))
        self.hands: Hands = Hands(self.arms)
        self.rest_neck: Vec = body.joints[NECK]
        self.pelvis_rest: Vec = body.joints[PELVIS]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.ground.reset()
        self.heading.reset()
        self.pelvis.reset()
        self.spine.reset()
        self.legs.reset()
        for arm in self.arms:
            arm.reset()
        self._before: Vec | None = None
        self._seen = 0
        self._origin: Vec = (0.0, 0.0, 0.0)  # where the body was lately
        self._away = 0.0
        self._placed = False
        self._velocity: Vec = (0.0, 0.0, 0.0)  # of the base, lightly smoothed
        self._travel: Vec = (0.0, 0.0, 0.0)  # horizontal, smoothed over a step
        self._slow: Vec = (0.0, 0.0, 0.0)  # horizontal, smoothed by SLOW more: walking or only swaying
        self._twist = 0.0
        self.hands.reset()
        self._walking = 0.0

    def solve(self, targets: Targets, dt: float) -> Solution:
        """One moment. See the module's docstring for the order of things."""
        legs = self.legs
        targets = self.ground.bring(targets, legs.slack, legs.clearance.tiptoe, dt)
        torso = self.torso(targets, dt)
        limbs = self.stepped(targets, torso, dt)
        arms = reaching(self.arms, self.hands, targets, torso, dt)
        notes = self.ground.notes
        return self.ground.lift(assembled(torso, limbs, arms, legs.legs, legs.feet, self.body.sole, legs.air, notes))

    def torso(self, targets: Targets, dt: float) -> Torso:
        """Torso for a head within reach."""
        legs, spine = self.legs, self.spine
        self.pelvis.update(targets.pelvis, targets.pelvis_turn, targets.eye, dt)
        tracked = self.pelvis.facing(dt)
        speed = hypot(self._travel[0], self._travel[2])
        yaw = self.heading.update(
            targets.head, targets.eye, targets.left, targets.right, self._travel, speed, dt, tracked
        )
        neck = spine.neck_point(targets.eye, targets.head, yaw)
        speed = hypot(self._travel[0], self._travel[2])
        feet = legs.feet
        facing = yaw_quat(-yaw)
        behind = [rotate(facing, foot.ball)[2] for foot in feet]
        legs.gait.update(
            neck, yaw, targets.left, targets.right, self._slow, speed, self._away, behind[0] < behind[1], dt
        )
        moving = clamp((speed - 0.25) / 0.5, 0.0, 1.0) * clamp((self._away - 0.12) / 0.15, 0.0, 1.0)
        moving = max(moving, 1.0 if legs.gait.walking else 0.0)
        self._walking += (moving - self._walking) * (1 - exp(-dt / 0.1)) if self._seen > 3 else moving
        middle = legs.middle()
        balance = (0.0, 0.0)
        if middle is not None:
            rest = rotate(
                yaw_quat(yaw), (self.rest_neck[0] - self.pelvis_rest[0], 0.0, self.rest_neck[2] - self.pelvis_rest[2])
            )
            local = rotate(facing, (neck[0] - middle[0] - rest[0], 0.0, neck[2] - middle[1] - rest[2]))
            balance = (local[2], local[0])
        self._twist = TWIST * self.heading.hands
        torso = spine.update(
            targets.eye, targets.head, yaw, self.heading.head_yaw, balance, self._walking, speed, self._twist, dt
        )
        return self.pelvis.bring(spine, targets.eye, targets.head, torso)

    def stepped(self, targets: Targets, torso: Torso, dt: float, shown: bool = True) -> list[Limb]:
        """Legs under a torso, which ``torso`` returned for these targets, or another one; see ``Legs.update``."""
        legs = self.legs
        base = self._base(torso)
        self._motion(base, dt)
        speed = hypot(self._travel[0], self._travel[2])
        if legs.gait.walking and self._seen <= 3 and not self._placed:
            self._placed = True
            legs.start_walking(speed)
        course = (self._travel, self._slow, speed, dt)
        yaw = self.heading.yaw
        return legs.update(base, torso.pelvis_at, torso.pelvis, yaw, *course, targets.feet, targets.knees, shown)

    def _motion(self, base: Vec, dt: float) -> None:
        if self._before is None:
            self._before = self._origin = base
            return
        self._seen += 1
        least = 1 / self._seen  # a start in mid-walk: the first velocities count at once
        before = self._travel
        k = 1 / max(dt, 1e-4)
        n, p = base, self._before
        now = ((n[0] - p[0]) * k, (n[1] - p[1]) * k, (n[2] - p[2]) * k)
        a, b = max(1 - exp(-dt / 0.04), least), max(1 - exp(-dt / 0.12), least)
        v, t = self._velocity, self._travel
        self._velocity = (v[0] + (now[0] - v[0]) * a, v[1] + (now[1] - v[1]) * a, v[2] + (now[2] - v[2]) * a)
        v = self._velocity
        self._travel = (t[0] + (v[0] - t[0]) * b, 0.0, t[2] + (v[2] - t[2]) * b)
        self._before = base
        o = self._origin
        if self._seen == 1:  # a recording may begin in mid-walk
            t = self._travel
            o = (base[0] - 0.8 * t[0], 0.0, base[2] - 0.8 * t[2])
        d = 1 - exp(-dt / 0.8)
        self._origin = o = (o[0] + (base[0] - o[0]) * d, 0.0, o[2] + (base[2] - o[2]) * d)
        self._away = hypot(base[0] - o[0], base[2] - o[2])
        c = max(1 - exp(-0.5 * dt / SLOW), least)  # of half the sample: towards the travel before it, then after it
        self._slow = _towards(_towards(self._slow, before, c), self._travel, c)

    @staticmethod
    def _base(torso: Torso) -> Vec:
        """Where the body's mass is over the ground: mostly at the pelvis, the rest at chest and head."""
        p, n = torso.pelvis_at, torso.neck_at
        return (0.65 * p[0] + 0.35 * n[0], 0.0, 0.65 * p[2] + 0.35 * n[2])


def _towards(point: Vec, goal: Vec, share: float) -> Vec:
    """A horizontal vector, by ``share`` of the way."""
    return (point[0] + (goal[0] - point[0]) * share, 0.0, point[2] + (goal[2] - point[2]) * share)
