"""The analytic solver: head to pelvis, hands through the arms, feet by balance and gait; tracked joints as tracked."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, hypot
from typing import ClassVar

from glsplat.tracking.solve.arms import ArmPose, Arms
from glsplat.tracking.solve.body import (
    ANKLES,
    COLLARS,
    ELBOWS,
    HEAD,
    HIPS,
    KNEES,
    NECK,
    PELVIS,
    SHOULDERS,
    WRISTS,
    Body,
)
from glsplat.tracking.solve.foot import Foot
from glsplat.tracking.solve.heading import Heading
from glsplat.tracking.solve.height_limit import HeightLimit
from glsplat.tracking.solve.leg import Leg, LegPose
from glsplat.tracking.solve.legs import Legs
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec, add, clamp, inverse_mul, mul, pull, rotate, sub, yaw_quat
from glsplat.tracking.solve.solution import Solution, Targets
from glsplat.tracking.solve.spine import SPINES, Spine, Torso
from glsplat.tracking.solve.tracked import TrackedPelvis

CHEST_TWIST = 0.2  # of the yaw that both hands suggest, by which the chest turns further than the pelvis
SLOW_SMOOTHING_S = 0.125  # of the speed that tells walking from swaying; twice that scores worse (docs/tracking.md)
BASE_SMOOTHING_S, TRAVEL_SMOOTHING_S = 0.04, 0.12  # of the velocity of the body's mass, over a step
ORIGIN_SMOOTHING_S = 0.8  # of where the body was lately
WALKING_SMOOTHING_S = 0.1
FIRST_SAMPLES = 3  # after which a recording no longer begins in mid-walk
MIN_STEP_S = 1e-4
MAX_PLANTED_HEIGHT_M = 1e-3  # a planted foot may still be that far above the floor
AIRBORNE_M = 0.01  # both feet are that far off the ground


class AnalyticSolver:
    """Head to pelvis through the spine, hands through the arms, feet by balance and gait: closed forms, no training."""

    keeps_limits: ClassVar[bool] = True  # rotations are within the joints' limits

    def __init__(self, body: Body) -> None:
        self.body = body
        self.ground: HeightLimit = HeightLimit(body.eye_height)
        self.heading: Heading = Heading()
        self.spine: Spine = Spine(body)
        self.pelvis: TrackedPelvis = TrackedPelvis()
        self.legs: Legs = Legs(body)
        self.arms: Arms = Arms(body)
        self.rest_neck: Vec = sub(body.joints[NECK], body.joints[PELVIS])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        for part in (self.ground, self.heading, self.pelvis, self.spine, self.legs, self.arms):
            part.reset()
        self._last_base: Vec | None = None
        self._count = 0  # of samples after the first
        self._origin: Vec = (0.0, 0.0, 0.0)  # where the body was lately
        self._away = 0.0  # metres from there
        self._walk_started = False
        self._velocity: Vec = (0.0, 0.0, 0.0)  # m/s of the base, lightly smoothed
        self._travel: Vec = (0.0, 0.0, 0.0)  # likewise, smoothed over a step
        self._slow: Vec = (0.0, 0.0, 0.0)  # likewise, smoothed by SLOW_SMOOTHING_S more
        self._walking = 0.0  # 0 standing .. 1 walking

    def solve(self, targets: Targets, dt: float) -> Solution:
        """Return the body: ground, torso, legs, arms."""
        legs = self.legs
        targets = self.ground.limit(targets, legs.slack, legs.tiptoe, dt)
        torso = self.torso(targets, dt)
        leg_poses = self.step(targets, torso, dt)
        arm_poses = self.arms.solve(targets, torso, dt)
        solution = assembled(torso, leg_poses, arm_poses, legs.legs, legs.feet, legs.air, self.ground.notes)
        return self.ground.raised(solution)

    def torso(self, targets: Targets, dt: float) -> Torso:
        """Return the torso of a head within reach."""
        gait, spine, eye, head = self.legs.gait, self.spine, targets.eye, targets.head
        self.pelvis.update(targets.pelvis, targets.pelvis_turn, eye, dt)
        speed = hypot(self._travel[0], self._travel[2])
        hands = targets.left, targets.right
        yaw = self.heading.update(head, eye, *hands, self._travel, speed, dt, self.pelvis.heading(dt))
        neck = spine.neck_point(eye, head, yaw)
        to_heading = yaw_quat(-yaw)
        left, right = [rotate(to_heading, foot.ball)[2] for foot in self.legs.feet]
        gait.update(neck, yaw, *hands, self._slow, speed, self._away, left < right, dt)
        moving = clamp((speed - 0.25) / 0.5, 0.0, 1.0) * clamp((self._away - 0.12) / 0.15, 0.0, 1.0)
        moving = 1.0 if gait.walking else moving
        k = 1 - exp(-dt / WALKING_SMOOTHING_S)
        self._walking += (moving - self._walking) * k if self._count > FIRST_SAMPLES else moving
        middle = self.legs.middle()
        balance = (0.0, 0.0)
        if middle is not None:
            rest = rotate(yaw_quat(yaw), (self.rest_neck[0], 0.0, self.rest_neck[2]))
            local = rotate(to_heading, (neck[0] - middle[0] - rest[0], 0.0, neck[2] - middle[1] - rest[2]))
            balance = (local[2], local[0])
        twist = CHEST_TWIST * self.heading.hands
        torso = spine.update(eye, head, yaw, self.heading.head_yaw, balance, self._walking, speed, twist, dt)
        return self.pelvis.apply(spine, eye, head, torso)

    def step(self, targets: Targets, torso: Torso, dt: float, shown: bool = True) -> list[LegPose]:
        """Return the legs under a torso, that of ``torso`` for these targets or another one; see ``Legs.update``."""
        # the body's mass over the ground: mostly at the pelvis, the rest at chest and head
        pelvis, neck = torso.pelvis_at, torso.neck_at
        base = (0.65 * pelvis[0] + 0.35 * neck[0], 0.0, 0.65 * pelvis[2] + 0.35 * neck[2])
        self._update_motion(base, dt)
        speed = hypot(self._travel[0], self._travel[2])
        if self.legs.gait.walking and self._count <= FIRST_SAMPLES and not self._walk_started:
            self._walk_started = True
            self.legs.start_walking(speed)
        course = (self._travel, self._slow, speed, dt)
        tracked = (targets.feet, targets.knees)
        return self.legs.update(base, pelvis, torso.pelvis, self.heading.yaw, *course, *tracked, shown)

    def _update_motion(self, base: Vec, dt: float) -> None:
        """Update the smoothed velocities of the body's mass."""
        if self._last_base is None:
            self._last_base = self._origin = base
            return
        self._count += 1
        least = 1 / self._count  # a start in mid-walk: the first velocities count at once
        rate, last = 1 / max(dt, MIN_STEP_S), self._last_base
        velocity = ((base[0] - last[0]) * rate, 0.0, (base[2] - last[2]) * rate)
        self._velocity = pull(self._velocity, velocity, max(1 - exp(-dt / BASE_SMOOTHING_S), least))
        before, k = self._travel, max(1 - exp(-dt / TRAVEL_SMOOTHING_S), least)
        self._travel = travel = pull(before, self._velocity, k)
        self._last_base = base
        if self._count == 1:  # a recording may begin in mid-walk
            self._origin = (base[0] - 0.8 * travel[0], 0.0, base[2] - 0.8 * travel[2])
        self._origin = pull(self._origin, base, 1 - exp(-dt / ORIGIN_SMOOTHING_S))
        self._away = hypot(base[0] - self._origin[0], base[2] - self._origin[2])
        k = max(1 - exp(-0.5 * dt / SLOW_SMOOTHING_S), least)  # half a step towards each of the two travels
        self._slow = pull(pull(self._slow, before, k), travel, k)


def assembled(
    torso: Torso,
    leg_poses: Sequence[LegPose],  # left and right
    arm_poses: Sequence[ArmPose],
    legs: Sequence[Leg],
    feet: Sequence[Foot],  # strained where a joint's limit moves them
    air: float,  # metres both feet are off the ground
    notes: list[str],
) -> Solution:
    """Return the body: local rotations inside the joints' limits."""
    out: list[Quat] = [IDENTITY] * 22
    out[PELVIS] = torso.pelvis
    for joint in SPINES:
        out[joint] = torso.third
    out[NECK] = inverse_mul(torso.spine3, torso.neck)
    out[HEAD] = inverse_mul(torso.neck, torso.head)
    balls: list[Vec | None] = [None, None]
    for i in (0, 1):
        thigh, knee, foot = leg_poses[i]
        free_hip = inverse_mul(torso.pelvis, thigh)
        out[HIPS[i]] = hip = clamp_joint(HIPS[i], free_hip)
        limited = hip is not free_hip
        if limited:
            thigh = mul(torso.pelvis, hip)
            hip_at = add(torso.pelvis_at, rotate(torso.pelvis, legs[i].hip))
            knee = clamp_joint(KNEES[i], legs[i].settle(hip_at, thigh, knee))
        out[KNEES[i]] = knee
        free_ankle = inverse_mul(mul(thigh, knee), foot)
        out[ANKLES[i]] = ankle = clamp_joint(ANKLES[i], free_ankle)
        if limited or ankle is not free_ankle:  # a joint's limit moves the foot: it has to step
            feet[i].strained = True
        elif not feet[i].strained:
            balls[i] = legs[i].ball
        arm = arm_poses[i]
        out[COLLARS[i]], out[SHOULDERS[i]] = arm.collar, arm.shoulder
        out[ELBOWS[i]], out[WRISTS[i]] = arm.elbow, arm.wrist
    left, right = [
        foot.planted and ball is not None and abs(foot.y.at - leg.sole) < MAX_PLANTED_HEIGHT_M
        for foot, ball, leg in zip(feet, balls, legs, strict=True)
    ]
    misses = (arm_poses[0].miss, arm_poses[1].miss)
    known = (balls[0], balls[1])
    return Solution(out, torso.pelvis_at, misses, torso.head_off, (left, right), air > AIRBORNE_M, notes, known)
