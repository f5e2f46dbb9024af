"""Solver: from clean targets to a full body. The protocol a learned model can fill, and the analytic default."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import exp, hypot
from typing import Protocol

from glsplat.tracking.solve.arms import Arm, ArmPose
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
    SPINE1,
    SPINE2,
    SPINE3,
    WRISTS,
    Body,
)
from glsplat.tracking.solve.heading import Heading
from glsplat.tracking.solve.legs import Legs
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import (
    IDENTITY,
    Quat,
    Vec,
    add,
    clamp,
    conj,
    inverse_mul,
    mul,
    nlerp,
    pull,
    rotate,
    sub,
    to_quat,
    unit,
    yaw_quat,
)
from glsplat.tracking.solve.spine import Spine, Torso

LONGEST_JUMP = 0.7  # seconds; a head out of reach for longer is not a jump (0.7 s in the air is a leap of 0.6 m)
HOLD, SINK, REGAIN = 0.25, 0.35, 0.2  # seconds: a lost hand stays, sinks to the side, is taken up again
TWIST = 0.2  # of the yaw that both hands suggest by which the chest turns further than the pelvis
RESTING = 1e-3  # metres a planted foot may still be above the floor
SLOW = 0.125  # seconds; twice that scores worse on motion capture (docs/tracking.md)
LOWEST_EYE = 0.04  # of the eye height: a head on the floor

__all__ = ["AnalyticSolver", "Solution", "Solver", "Targets"]


@dataclass(slots=True)
class Targets:
    """Filtered, calibrated targets in the avatar's metres, the ground at y = 0. Rotations are those of the joints."""

    eye: Vec  # between the eyes
    head: Quat
    left: Vec | None = None  # wrist joint
    left_hand: Quat = IDENTITY
    right: Vec | None = None
    right_hand: Quat = IDENTITY


@dataclass(slots=True)
class Solution:
    """Local rotations of the 22 body joints, the pelvis' place, and what could not be met."""

    rotations: list[Quat]
    pelvis: Vec
    reach: tuple[float, float] = (0.0, 0.0)  # metres the left and right wrist miss their targets by
    head_off: float = 0.0  # radians the head had to give up
    planted: tuple[bool, bool] = (True, True)
    airborne: bool = False
    notes: list[str] = field(default_factory=list)
    feet: tuple[Vec | None, Vec | None] = (None, None)  # places of the foot joints, where they are known exactly


class Solver(Protocol):
    """What ``Tracker`` calls. Bring another one to plug in a learned model."""

    def reset(self) -> None:
        """A teleport or a new user: forget the past."""

    def solve(self, targets: Targets, dt: float) -> Solution:
        """The body of this moment, ``dt`` (0 < dt <= 0.1 s) after the last one. Must be deterministic."""


@dataclass(slots=True)
class _Memory:
    """Where a hand was last, in the chest's frame."""

    at: Vec = (0.0, 0.0, 0.0)
    turn: Quat = IDENTITY
    known: bool = False
    lost: float = 0.0  # seconds
    away: float = 0.0  # 1 lost .. 0 tracked


class AnalyticSolver:
    """Head to pelvis through the spine, hands through the arms, feet by balance and gait: closed forms, no training."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.heading: Heading = Heading()
        self.spine: Spine = Spine(body)
        self.legs: Legs = Legs(body)
        self.arms: tuple[Arm, Arm] = (Arm(body, 0), Arm(body, 1))
        self.rest_neck: Vec = body.joints[NECK]
        self.pelvis_rest: Vec = body.joints[PELVIS]
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.heading.reset()
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
        self._memory = (_Memory(), _Memory())
        self._flight = 0.0  # seconds in the air
        self._sink = 0.0  # metres the body stays below a head that is out of reach
        self._walking = 0.0

    def solve(self, targets: Targets, dt: float) -> Solution:
        """One moment. See the module's docstring for the order of things."""
        legs, spine = self.legs, self.spine
        targets = self._grounded(targets, dt)
        speed = hypot(self._travel[0], self._travel[2])
        yaw = self.heading.update(targets.head, targets.eye, targets.left, targets.right, self._travel, speed, dt)
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
        base = self._base(torso)
        self._motion(base, dt)
        speed = hypot(self._travel[0], self._travel[2])
        if legs.gait.walking and self._seen <= 3 and not self._placed:
            self._placed = True
            legs.start_walking(speed)
        limbs = legs.update(base, torso.pelvis_at, torso.pelvis, yaw, self._travel, self._slow, speed, dt)
        arms = [
            arm.solve(torso.spine3, torso.spine3_at, *self._hand(arm.index, targets, torso, dt), dt)
            for arm in self.arms
        ]
        return self._assemble(torso, limbs, arms)

    def _grounded(self, targets: Targets, dt: float) -> Targets:
        """The head within the body's reach: above the floor, and not higher than the legs allow for longer than a jump.

        A user taller than the avatar, or a head that looks straight down without bending, would else float for ever.
        """
        slack = self.legs.slack  # of the last moment: metres left until the tiptoes lose the ground
        self._flight = self._flight + dt if slack < 0 else 0.0
        if self._flight > LONGEST_JUMP or self._sink > 0:
            # down to flat feet, and up again with the head
            self._sink = max(0.0, self._sink - (slack - self.legs.tiptoe) * (1 - exp(-dt / 0.25)))
        x, y, z = targets.eye
        sunk = max(y - self._sink, LOWEST_EYE * self.body.eye_height)
        if sunk == y:
            return targets
        return replace(targets, eye=(x, sunk, z))

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

    def _hand(self, index: int, targets: Targets, torso: Torso, dt: float) -> tuple[Vec, Quat]:
        """The hand to reach for. A lost hand is held for a moment, then sinks to the side; a found one is taken up."""
        at, hand = (targets.left, targets.left_hand) if index == 0 else (targets.right, targets.right_hand)
        memory = self._memory[index]
        inverse = conj(torso.spine3)
        if at is not None and memory.away <= 0:
            memory.at, memory.turn = rotate(inverse, sub(at, torso.spine3_at)), mul(inverse, hand)
            memory.lost, memory.known = 0.0, True
            return at, hand
        if at is not None:  # found again: over in a moment
            memory.away = max(0.0, memory.away - dt / REGAIN)
            memory.lost = 0.0
        else:
            memory.away = 1.0
            memory.lost += dt
        rest_at, rest_turn = self._relaxed(index, torso)
        if not memory.known:  # never seen
            memory.at, memory.turn, memory.known, memory.lost = rest_at, rest_turn, True, HOLD
        if memory.lost > HOLD:
            k = 1 - exp(-dt / SINK)
            memory.at, memory.turn = pull(memory.at, rest_at, k), nlerp(memory.turn, rest_turn, k)
        free = rotate(torso.spine3, memory.at)
        place = (torso.spine3_at[0] + free[0], torso.spine3_at[1] + free[1], torso.spine3_at[2] + free[2])
        turn = mul(torso.spine3, memory.turn)
        if at is not None:
            e = memory.away * memory.away * (3 - 2 * memory.away)
            return pull(at, place, e), nlerp(hand, turn, e)
        return place, turn

    def _relaxed(self, index: int, torso: Torso) -> tuple[Vec, Quat]:
        """A hanging hand, the palm towards the thigh, in the chest's frame: gravity and the pelvis decide where."""
        arm = self.arms[index]
        sign = arm.sign
        inverse = conj(torso.spine3)
        down = unit(rotate(inverse, rotate(torso.pelvis, (0.12 * sign, -1.0, 0.12))))
        far = 0.96 * arm.reach
        x, y, z = arm.rest
        turn = mul(inverse, mul(torso.pelvis, to_quat((0.0, 0.0, -1.45 * sign))))
        return (x + down[0] * far, y + down[1] * far, z + down[2] * far), turn

    def _assemble(self, torso: Torso, limbs: list[tuple[Quat, Quat, Quat]], arms: list[ArmPose]) -> Solution:
        out = [IDENTITY] * 22
        out[PELVIS] = torso.pelvis
        out[SPINE1] = out[SPINE2] = out[SPINE3] = torso.third
        out[NECK] = inverse_mul(torso.spine3, torso.neck)
        out[HEAD] = inverse_mul(torso.neck, torso.head)
        feet: list[Vec | None] = [None, None]
        for i in (0, 1):
            thigh, knee, foot = limbs[i]
            free = inverse_mul(torso.pelvis, thigh)
            out[HIPS[i]] = hip = clamp_joint(HIPS[i], free)
            bound = hip is not free
            if bound:
                thigh = mul(torso.pelvis, hip)
                leg = self.legs.legs[i]
                knee = clamp_joint(
                    KNEES[i], leg.settle(add(torso.pelvis_at, rotate(torso.pelvis, leg.hip)), thigh, knee)
                )
            out[KNEES[i]] = knee
            free = inverse_mul(mul(thigh, knee), foot)
            out[ANKLES[i]] = ankle = clamp_joint(ANKLES[i], free)
            if bound or ankle is not free:  # a joint's limit moves the foot: it has to step
                self.legs.feet[i].strained = True
            elif not self.legs.feet[i].strained:
                feet[i] = self.legs.legs[i].ball
            arm = arms[i]
            out[COLLARS[i]], out[SHOULDERS[i]], out[ELBOWS[i]], out[WRISTS[i]] = (
                arm.collar,
                arm.shoulder,
                arm.elbow,
                arm.wrist,
            )
        left, right = [
            foot.planted and known is not None and abs(foot.y.at - self.body.sole) < RESTING
            for foot, known in zip(self.legs.feet, feet, strict=True)
        ]
        return Solution(
            out,
            torso.pelvis_at,
            (arms[0].miss, arms[1].miss),
            torso.head_off,
            (left, right),
            self.legs.air > 0.01,
            ["head_out_of_reach"] if self._sink > 0.02 else [],
            (feet[0], feet[1]),
        )


def _towards(point: Vec, goal: Vec, share: float) -> Vec:
    """A horizontal vector, by ``share`` of the way."""
    return (point[0] + (goal[0] - point[0]) * share, 0.0, point[2] + (goal[2] - point[2]) * share)
