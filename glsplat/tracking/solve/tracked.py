"""Tracked pelvis and feet: taken up and given up smoothly, and met as far as head and floor allow."""

from __future__ import annotations

from math import atan2, exp

from glsplat.tracking.solve import quat
from glsplat.tracking.solve.foot import MAX_FOOT_SPEED, Foot
from glsplat.tracking.solve.leg import REFERENCE_LEG_M, Leg, LegPose
from glsplat.tracking.solve.quat import IDENTITY, JointPose, Quat, Vec, add, clamp, length, mul, pull, rotate, sub
from glsplat.tracking.solve.spine import Spine, Torso

FOUND_S, LOST_S = 0.25, 0.3  # in which a joint that is found or lost is taken up and given up
HEADING_RATE = 30.0  # 1/s: how fast the heading is taken up at half the weight
MAX_TILT_RAD = (1.1, 0.5, 0.6)  # from the guessed pelvis to a tracked one, about x, y, z
IMPLAUSIBLE_RAD = (1.9, 2.5)  # from the guessed pelvis: between them a waist tracker's rotation loses its weight
CHEST_SWING = 1.8  # of the angle that the pelvis misses its place by, seen from the neck, by which the chest turns
MAX_CHEST_SWING_RAD = 1.2  # in all
SWING_ROUNDS = 5
AFLOAT_M, STANDING_SPEED = 0.04, 0.2  # off the ground, m/s: limits of a tracked foot that stands
LOST_STEP_S = 0.36  # of the step that a lost foot takes


class TrackedWeight:
    """Weight of a tracked joint: 1 while tracked, at once in the first moment of a body; 0 once lost."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.share: float = 0.0  # before easing
        self._first = True

    def update(self, tracked: bool, dt: float) -> float:
        """Return the weight, smooth in time."""
        if tracked:
            self.share = 1.0 if self._first else min(1.0, self.share + dt / FOUND_S)
        else:
            self.share = max(0.0, self.share - dt / LOST_S)
        self._first = False
        return quat.smoothstep(self.share)


class TrackedPelvis:
    """The pelvis as tracked, from the eyes: a head that is moved to the floor takes it along."""

    def __init__(self) -> None:
        self._tracked_weight = TrackedWeight()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._tracked_weight.reset()
        self.weight: float = 0.0
        self._from_eye: Vec = (0.0, 0.0, 0.0)
        self._turn: Quat = IDENTITY
        self._yaw: float | None = None

    def update(self, at: Vec | None, turn: Quat, eye: Vec, dt: float) -> None:
        """Take up position and rotation of this moment; None: lost."""
        self.weight = self._tracked_weight.update(at is not None, dt)
        if at is None:
            return
        self._from_eye, self._turn = sub(at, eye), turn
        yaw = quat.swing_twist_y(turn)
        self._yaw = self._yaw if yaw is None else yaw

    def heading(self, dt: float) -> tuple[float, float] | None:
        """Return the heading in radians, and the part of the way to it that the body takes in this moment."""
        if self._yaw is None or self.weight <= 0:
            return None
        rate = HEADING_RATE * self.weight / max(1 - self.weight, 1e-6)
        return self._yaw, 1 - exp(-rate * dt)

    def apply(self, spine: Spine, eye: Vec, head: Quat, torso: Torso) -> Torso:
        """Return the torso with its pelvis where it is tracked; the eyes stay, the chest leans as it must."""
        if self.weight <= 0:
            return torso
        goal = pull(torso.pelvis_at, add(eye, self._from_eye), self.weight)
        turn = quat.inverse_mul(torso.pelvis, self._turn)
        low, high = IMPLAUSIBLE_RAD
        weight = self.weight * clamp((high - quat.rotation_angle(turn)) / (high - low), 0.0, 1.0)
        x, y, z = [clamp(v, -m, m) * weight for v, m in zip(quat.rotation_vector(turn), MAX_TILT_RAD, strict=True)]
        pelvis, chest, left = mul(torso.pelvis, quat.to_quat((x, y, z))), torso.spine3, MAX_CHEST_SWING_RAD
        for _ in range(SWING_ROUNDS):
            torso = spine.hang(eye, head, pelvis, chest)
            now, wanted = sub(torso.pelvis_at, torso.neck_at), sub(goal, torso.neck_at)
            axis = quat.cross(now, wanted)
            size = length(axis)
            if size < 1e-5 or left <= 0:
                return torso
            angle = min(CHEST_SWING * atan2(size, quat.dot(now, wanted)), left)
            left -= angle
            chest = mul(quat.about(quat.unit(axis), angle), chest)
        return spine.hang(eye, head, pelvis, chest)


class TrackedFoot:
    """A foot as tracked: the ankle's position and the foot's rotation, above the floor."""

    def __init__(self, leg: Leg) -> None:
        self.leg = leg
        self._tracked_weight = TrackedWeight()
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._tracked_weight.reset()
        self.ankle: Vec | None = None  # None: not tracked
        self.turn: Quat = IDENTITY
        self.knee: Vec | None = None
        self.height: float = 0.0  # metres the lowest point of the foot is above the floor
        self._begin: JointPose | None = None  # as shown when it was found

    def place(self, foot: Foot, goal: JointPose | None, knee: Vec | None, dt: float) -> None:
        """Put the foot where it is tracked, moving as its tracker does; a lost one goes on from there."""
        before = self.ankle is not None
        if not before and goal is None:
            self._tracked_weight.update(False, dt)
            return
        if goal is None:
            # given up at once: the foot steps from where it is
            self._tracked_weight.update(False, dt)
            self._tracked_weight.share = 0.0
            self.ankle = self.knee = self._begin = None
            if not foot.planted:
                size = self.leg.length / REFERENCE_LEG_M
                foot.lift(LOST_STEP_S, max(foot.y.at - self.leg.sole, 0.05 * size), False)
            return
        shown = self.leg.above(foot, foot.tilt.at), mul(quat.yaw_quat(foot.yaw), quat.to_quat((foot.tilt.at, 0, 0)))
        self._update(goal, knee, shown, dt)
        x, y, z = ball = self.ball
        moved = length(sub(ball, foot.ball)) / dt
        yaw = self.yaw
        values = (x, y, z, foot.turn.at if yaw is None else foot.turn.at + quat.wrap(yaw - foot.turn.at), self.tilt)
        for axis, value in zip(foot.axes, values, strict=True):
            speed = (value - axis.at) / dt if before else 0.0
            axis.put(value)
            axis.speed = clamp(speed, -MAX_FOOT_SPEED, MAX_FOOT_SPEED)
        foot.planted, foot.left = y < self.leg.sole + AFLOAT_M and moved < STANDING_SPEED, 0.0

    def solve(self, foot: Foot, hip: Vec, pelvis: Quat, yaw: float) -> LegPose | None:
        """Return the leg as ``Leg.solve`` does; None where the foot is not tracked."""
        if self.ankle is None:
            return None
        knee_to = None if self.knee is None else sub(self.knee, pull(hip, self.ankle, 0.5))
        return self.leg.follow(foot, self.ankle, self.turn, hip, pelvis, yaw, knee_to)

    def _update(self, goal: JointPose, knee: Vec | None, shown: JointPose, dt: float) -> None:
        """Take up a tracked foot; ``shown``: ankle and rotation of the foot as shown last."""
        weight = self._tracked_weight.update(True, dt)
        ankle, turn = goal
        if weight >= 1:
            self._begin = None
        else:
            begin = self._begin = self._begin or shown
            ankle, turn = pull(begin[0], ankle, weight), quat.nlerp(begin[1], turn, weight)
        low = self.leg.lowest(ankle, turn)
        self.ankle, self.turn, self.knee = add(ankle, (0.0, max(-low, 0.0), 0.0)), turn, knee
        self.height = max(low, 0.0)

    @property
    def ball(self) -> Vec:
        """World position of the foot joint."""
        assert self.ankle is not None
        return sub(self.ankle, rotate(self.turn, self.leg.ankle))

    @property
    def yaw(self) -> float | None:
        """Heading of the foot by its axis across, which a hanging foot has too. None where that is vertical."""
        x, _, z = rotate(self.turn, (1.0, 0.0, 0.0))
        return None if x * x + z * z < 0.09 else atan2(-z, x)

    @property
    def tilt(self) -> float:
        """Radians the heel is up."""
        x, y, z = rotate(self.turn, (0.0, 0.0, 1.0))
        return atan2(-y, max((x * x + z * z) ** 0.5, 1e-9))
