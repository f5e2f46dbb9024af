"""The learned solver: a network guesses torso and feet; inverse kinematics keeps head, hands, ground exact."""

from __future__ import annotations

from math import acos
from typing import ClassVar

from glsplat.extras.learned.expected import ExpectedError
from glsplat.extras.learned.feet import Feet, Rest
from glsplat.extras.learned.hints import Hint, Hints
from glsplat.extras.learned.network import PoseNetwork, embedded_network
from glsplat.extras.learned.seat import Seat
from glsplat.extras.learned.stance import Stance
from glsplat.extras.learned.steady import Steady
from glsplat.extras.learned.uncertainty import Uncertainty
from glsplat.tracking.solve.arms import Arm
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.hands import Hands
from glsplat.tracking.solve.height_limit import HeightLimit
from glsplat.tracking.solve.quat import (
    Quat,
    Vec,
    about,
    add,
    clamp,
    cross,
    dot,
    length,
    mul,
    pull,
    rotate,
    scale,
    slerp,
    sub,
    swing_twist_y,
    unit,
    wrap,
    yaw_quat,
)
from glsplat.tracking.solve.solution import Solution, Targets, assembled, reaching
from glsplat.tracking.solve.solver import AnalyticSolver
from glsplat.tracking.solve.spine import Spine, Torso
from glsplat.tracking.solve.stepping.legs import Legs
from glsplat.tracking.solve.tracked import Pelvis

__all__ = ["LearnedSolver"]

PLAIN = 0.3  # of the pelvis that the analytic solver places
BACK, FURTHER = 0.035, 0.2  # tangent of a lean back, and the share of what is beyond that is shown
SHRINK = 0.6  # of what a body is said to be turned away from its head, that is shown without hands
AHEAD, UNDER = 0.55, 0.85  # of a leg's length from below the hips to the balls of feet on a chair, and how surely
SWING = 0.7  # radians at most that the torso swings about the neck to bring the pelvis where it should be


class LearnedSolver:
    """What ``Solver`` asks for. Head and reachable hands are exact, whatever the network says; feet do not slide.

    PLAIN of the pelvis is the analytic solver's: the two are off in different ways, so that a mean is nearer than the
    worse of them, and where the network knows least of a person often nearer than either.
    Where the network has learned nothing (``Uncertainty``) all of it is the analytic solver's.
    """

    keeps_limits: ClassVar[bool] = True  # rotations are within the joints' limits

    def __init__(self, body: Body, network: PoseNetwork | None = None) -> None:
        network = network or embedded_network()
        self.body = body
        self.ground: HeightLimit = HeightLimit(body.eye_height)
        self.hints: Hints = Hints(body, network)
        self.doubt: Uncertainty = Uncertainty(body.eye_height)
        self.steady: Steady = Steady()
        self.plain: AnalyticSolver = AnalyticSolver(body)
        self.stance: Stance = Stance(body)
        self.expected: ExpectedError = ExpectedError(body.eye_height)
        self.seat: Seat = Seat(body)
        self.spine: Spine = Spine(body)
        self.feet: Feet = Feet(body)
        self.rest: Rest = Rest(body.eye_height / 1.6)
        self.pelvis: Pelvis = Pelvis()  # a tracked one
        self.arms: tuple[Arm, Arm] = (Arm(body, 0), Arm(body, 1))
        self.hands: Hands = Hands(self.arms)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.ground.reset()
        self.hints.reset()
        self.doubt.reset()
        self.steady.reset()
        self.plain.reset()
        self.stance.reset()
        self.expected.reset()
        self.seat.reset()
        self.spine.reset()
        self.feet.reset()
        self.rest.reset()
        self.pelvis.reset()
        self.hands.reset()
        for arm in self.arms:
            arm.reset()
        self._missed = 0.0  # metres that the worse arm missed its hand by
        self._steps: Feet | Legs | None = None  # whose feet are shown; None before the first moment

    def solve(self, targets: Targets, dt: float) -> Solution:
        """One moment."""
        before = self._steps or self.feet
        targets = self.ground.bring(targets, before.slack, before.clearance.tiptoe, dt)
        hint = self.hints.update(targets, dt)
        if targets.left is None and targets.right is None:
            self._face(hint, targets.head)
        rests = self.rest.update(targets.eye, swing_twist_y(targets.head) or 0.0, dt)
        lost = self.doubt.update(targets, self._missed, dt)
        steps = self._whose(lost)
        plain = self.plain.torso(targets, dt)
        expected = self.expected.update(targets, length(sub(hint.pelvis_at, plain.pelvis_at)), dt)
        if steps is self.feet:
            self.plain.stepped(targets, plain, dt, shown=False)
        stands = self.stance.update(targets, hint.feet, self.plain.legs.feet, dt)
        self.pelvis.update(targets.pelvis, targets.pelvis_turn, targets.eye, dt)
        # a pelvis that is tracked is known better than by either
        torso = self._mixed(targets, hint, plain, PLAIN * (1 - self.pelvis.share), lost, dt)
        place = self.seat.update(torso.pelvis_at, targets.eye, targets.head, dt) if lost < 1 else None
        if place is not None:
            torso = self._torso(targets, hint, place)
        torso = self.pelvis.bring(self.spine, targets.eye, targets.head, torso)
        if steps is self.feet:
            if place is not None:
                self._seated(hint, torso)
            yaw = swing_twist_y(torso.pelvis) or 0.0
            under = (torso.pelvis_at, torso.pelvis, yaw, dt, targets.feet, targets.knees)
            limbs = self.feet.update(hint.feet, *under, (rests or stands >= 1) and place is None)
        else:
            limbs = self.plain.stepped(targets, torso, dt)
        arms = reaching(self.arms, self.hands, targets, torso, dt)
        self._missed = max(arms[0].miss, arms[1].miss)
        notes = [*self.ground.notes, *(["sitting"] if self.seat.sits and lost < 1 else [])]
        out = assembled(torso, limbs, arms, steps.legs, steps.feet, self.body.sole, steps.air, notes)
        out.expected_error = expected
        return self.ground.lift(out)

    def _whose(self, lost: float) -> Feet | Legs:
        """Whose feet are shown: one takes over where the other has them."""
        before, steps = self._steps, self.plain.legs if lost > 0 else self.feet
        if steps is not before and before is not None:
            steps.reset(before.feet)
        self._steps = steps
        return steps

    def _mixed(self, targets: Targets, hint: Hint, plain: Torso, share: float, lost: float, dt: float) -> Torso:
        """``share`` of the analytic pelvis, and all of its torso where the network is ``lost``; the eyes stay.

        The chest is the network's, which has seen the hands that arms must reach from it.
        """
        if lost >= 1:
            self.steady.reset()
            return plain
        share += (1 - share) * lost
        hint.pelvis, hint.chest = slerp(hint.pelvis, plain.pelvis, share), slerp(hint.chest, plain.spine3, lost)
        return self._torso(targets, hint, self.steady.update(pull(hint.pelvis_at, plain.pelvis_at, share), dt))

    def _seated(self, hint: Hint, torso: Torso) -> None:
        """Feet where those of somebody on a chair are: on the ground, below the knees, the thighs ahead."""
        yaw, rests = self.seat.yaw, UNDER * self.seat.share
        for foot, leg in zip(hint.feet, self.feet.legs, strict=True):
            hip_x, hip_y, hip_z = leg.hip
            facing = yaw_quat(yaw)
            x, _, z = add(torso.pelvis_at, rotate(facing, (hip_x, 0.0, hip_z + AHEAD * leg.length)))
            knee = add(torso.pelvis_at, rotate(facing, (hip_x, hip_y, hip_z + leg.limb.upper)))
            foot.knee = pull(foot.knee, knee, rests)
            foot.ball = pull(foot.ball, (x, min(foot.ball[1], self.body.sole), z), rests)
            foot.stands += (1 - foot.stands) * rests
            foot.speed = scale(foot.speed, 1 - rests)
            foot.yaw += wrap(yaw - foot.yaw) * rests

    def _face(self, hint: Hint, head: Quat) -> None:
        """Nearer to the head's heading: which way a body faces is hard to tell without hands."""
        ahead, pelvis = swing_twist_y(head), swing_twist_y(hint.pelvis)
        if ahead is not None and pelvis is not None:
            turn = yaw_quat((1 - SHRINK) * wrap(ahead - pelvis))
            hint.pelvis, hint.chest = mul(turn, hint.pelvis), mul(turn, hint.chest)

    def _torso(self, targets: Targets, hint: Hint, place: Vec) -> Torso:
        """The hinted torso, hung on the head, and swung about the neck so that the pelvis is below or at ``place``."""
        torso = self.spine.hang(targets.eye, targets.head, hint.pelvis, hint.chest)
        now, goal = unit(sub(torso.pelvis_at, torso.neck_at)), unit(_not_behind(sub(place, torso.neck_at), hint.pelvis))
        axis = cross(now, goal)
        size = length(axis)
        if size < 1e-6:
            return torso
        angle = min(acos(clamp(dot(now, goal), -1.0, 1.0)), SWING)
        swing = about((axis[0] / size, axis[1] / size, axis[2] / size), angle)
        return self.spine.hang(targets.eye, targets.head, mul(swing, hint.pelvis), mul(swing, hint.chest))


def _not_behind(way: Vec, pelvis: Quat) -> Vec:
    """The way from the neck to the pelvis, for a torso that leans back little: nobody does for long."""
    yaw = swing_twist_y(pelvis)
    if yaw is None or way[1] >= 0:
        return way
    x, y, z = rotate(yaw_quat(-yaw), way)
    most = -BACK * y
    return way if z <= most else rotate(yaw_quat(yaw), (x, y, most + FURTHER * (z - most)))
