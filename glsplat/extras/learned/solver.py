"""The learned solver: a network estimates torso and feet; inverse kinematics keeps head, hands and ground exact."""

from __future__ import annotations

from math import acos
from typing import ClassVar

from glsplat.extras.learned.feet import Feet
from glsplat.extras.learned.hints import Hint, Hints
from glsplat.extras.learned.network import PoseNetwork, embedded_network
from glsplat.extras.learned.posture import HeadRest, Seat, Stance, SteadyPosition
from glsplat.extras.learned.uncertainty import ExpectedError, Uncertainty
from glsplat.tracking.solve import quat
from glsplat.tracking.solve.arms import Arms
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.height_limit import HeightLimit
from glsplat.tracking.solve.legs import Legs
from glsplat.tracking.solve.quat import Quat, Vec, add, clamp, length, pull, rotate, scale, sub, wrap
from glsplat.tracking.solve.solution import Solution, Targets
from glsplat.tracking.solve.solver import AnalyticSolver, assembled
from glsplat.tracking.solve.spine import Spine, Torso
from glsplat.tracking.solve.tracked import TrackedPelvis

ANALYTIC_SHARE = 0.3  # of the pelvis' position and rotation
LEAN_BACK, LEAN_BACK_SHARE = 0.035, 0.2  # tangent of a lean back, and the share kept of any excess
HEADING_SHARE = 0.6  # share kept of the estimated turn from head to body without hands
SEAT_FEET_AHEAD, SEAT_WEIGHT = 0.55, 0.85  # from hips to balls, horizontally, in leg lengths; weight of this estimate
MAX_SWING_RAD = 0.7  # of the torso about the neck, to move the pelvis


class LearnedSolver:
    """A ``Solver`` with a network. Head and reachable hands are exact for any output of the network; feet do not slide.

    The pelvis is ANALYTIC_SHARE of the analytic solver's: errors of both differ, so a mean is better than the worse of
    them, and often than either. Outside the network's training (``Uncertainty``) the pelvis is the analytic solver's.
    """

    keeps_limits: ClassVar[bool] = True  # rotations are within the joints' limits

    def __init__(self, body: Body, network: PoseNetwork | None = None) -> None:
        network = network or embedded_network()
        self.body = body
        self.ground: HeightLimit = HeightLimit(body.eye_height)
        self.hints: Hints = Hints(body, network)
        self.uncertainty: Uncertainty = Uncertainty(body.eye_height)
        self.steady: SteadyPosition = SteadyPosition()
        self.analytic: AnalyticSolver = AnalyticSolver(body)
        self.stance: Stance = Stance(body)
        self.expected: ExpectedError = ExpectedError(body.eye_height)
        self.seat: Seat = Seat(body)
        self.spine: Spine = Spine(body)
        self.feet: Feet = Feet(body)
        self.head_rest: HeadRest = HeadRest(body.eye_height / 1.6)
        self.pelvis: TrackedPelvis = TrackedPelvis()
        self.arms: Arms = Arms(body)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        guesses = (self.hints, self.uncertainty, self.steady, self.analytic, self.stance, self.expected, self.seat)
        for part in (*guesses, self.ground, self.spine, self.feet, self.head_rest, self.pelvis, self.arms):
            part.reset()
        self._miss = 0.0  # distance of the worse arm from its hand, metres
        self._shown: Feet | Legs | None = None  # the shown solver's feet; None before the first sample

    def solve(self, targets: Targets, dt: float) -> Solution:
        """Return the body: ground, hints, torso, seat, legs, arms."""
        before = self._shown or self.feet
        targets = self.ground.limit(targets, before.slack, before.tiptoe, dt)
        hint = self.hints.update(targets, dt)
        if targets.left is None and targets.right is None:
            self._turn_to_head(hint, targets.head)
        rests = self.head_rest.update(targets.eye, quat.swing_twist_y(targets.head) or 0.0, dt)
        lost = self.uncertainty.update(targets, self._miss, dt)
        shown = self._shown_feet(lost)
        analytic = self.analytic.torso(targets, dt)
        expected = self.expected.update(targets, length(sub(hint.pelvis_at, analytic.pelvis_at)), dt)
        if shown is self.feet:
            self.analytic.step(targets, analytic, dt, shown=False)
        stands = self.stance.update(targets, hint.feet, self.analytic.legs.feet, dt)
        self.pelvis.update(targets.pelvis, targets.pelvis_turn, targets.eye, dt)
        # a tracked pelvis is better than both guesses
        torso = self._mixed(targets, hint, analytic, ANALYTIC_SHARE * (1 - self.pelvis.weight), lost, dt)
        place = self.seat.update(torso.pelvis_at, targets.eye, targets.head, dt) if lost < 1 else None
        if place is not None:
            torso = self._torso(targets, hint, place)
        torso = self.pelvis.apply(self.spine, targets.eye, targets.head, torso)
        if shown is self.feet:
            if place is not None:
                self._seat_feet(hint, torso)
            yaw = quat.swing_twist_y(torso.pelvis) or 0.0
            under = (torso.pelvis_at, torso.pelvis, yaw, dt, targets.feet, targets.knees)
            legs = self.feet.update(hint.feet, *under, (rests or stands >= 1) and place is None)
        else:
            legs = self.analytic.step(targets, torso, dt)
        arms = self.arms.solve(targets, torso, dt)
        self._miss = max(arms[0].miss, arms[1].miss)
        notes = [*self.ground.notes, *(["sitting"] if self.seat.sits and lost < 1 else [])]
        out = assembled(torso, legs, arms, shown.legs, shown.feet, shown.air, notes)
        out.expected_error = expected
        return self.ground.raised(out)

    def _shown_feet(self, lost: float) -> Feet | Legs:
        """Return the shown feet; at a change, one solver's feet continue from the other's."""
        before, shown = self._shown, self.analytic.legs if lost > 0 else self.feet
        if shown is not before and before is not None:
            shown.reset(before.feet)
        self._shown = shown
        return shown

    def _mixed(self, targets: Targets, hint: Hint, analytic: Torso, share: float, lost: float, dt: float) -> Torso:
        """Return a torso with ``share`` of the analytic pelvis, all of it if the network is ``lost``.

        The eyes do not move. The chest is the network's, which knows the hands that arms must reach from it.
        """
        if lost >= 1:
            self.steady.reset()
            return analytic
        share += (1 - share) * lost
        hint.pelvis = quat.slerp(hint.pelvis, analytic.pelvis, share)
        hint.chest = quat.slerp(hint.chest, analytic.spine3, lost)
        return self._torso(targets, hint, self.steady.update(pull(hint.pelvis_at, analytic.pelvis_at, share), dt))

    def _seat_feet(self, hint: Hint, torso: Torso) -> None:
        """Move the feet's hints for a chair: on the ground, below the knees, the thighs ahead."""
        yaw, rests = self.seat.yaw, SEAT_WEIGHT * self.seat.share
        for foot, leg in zip(hint.feet, self.feet.legs, strict=True):
            hip_x, hip_y, hip_z = leg.hip
            facing = quat.yaw_quat(yaw)
            x, _, z = add(torso.pelvis_at, rotate(facing, (hip_x, 0.0, hip_z + SEAT_FEET_AHEAD * leg.length)))
            knee = add(torso.pelvis_at, rotate(facing, (hip_x, hip_y, hip_z + leg.limb.upper)))
            foot.knee = pull(foot.knee, knee, rests)
            foot.ball = pull(foot.ball, (x, min(foot.ball[1], self.body.sole), z), rests)
            foot.stance += (1 - foot.stance) * rests
            foot.speed = scale(foot.speed, 1 - rests)
            foot.yaw += wrap(yaw - foot.yaw) * rests

    def _turn_to_head(self, hint: Hint, head: Quat) -> None:
        """Turn the body towards the head's heading, as its own is hard to estimate without hands."""
        ahead, pelvis = quat.swing_twist_y(head), quat.swing_twist_y(hint.pelvis)
        if ahead is not None and pelvis is not None:
            turn = quat.yaw_quat((1 - HEADING_SHARE) * wrap(ahead - pelvis))
            hint.pelvis, hint.chest = quat.mul(turn, hint.pelvis), quat.mul(turn, hint.chest)

    def _torso(self, targets: Targets, hint: Hint, place: Vec) -> Torso:
        """Return the hinted torso below the head, its pelvis swung about the neck towards ``place``."""
        torso = self.spine.hang(targets.eye, targets.head, hint.pelvis, hint.chest)
        now, goal = (
            quat.unit(sub(torso.pelvis_at, torso.neck_at)),
            quat.unit(_not_behind(sub(place, torso.neck_at), hint.pelvis)),
        )
        axis = quat.cross(now, goal)
        size = length(axis)
        if size < 1e-6:
            return torso
        angle = min(acos(clamp(quat.dot(now, goal), -1.0, 1.0)), MAX_SWING_RAD)
        swing = quat.about((axis[0] / size, axis[1] / size, axis[2] / size), angle)
        return self.spine.hang(targets.eye, targets.head, quat.mul(swing, hint.pelvis), quat.mul(swing, hint.chest))


def _not_behind(way: Vec, pelvis: Quat) -> Vec:
    """Limit the backward lean of the vector from neck to pelvis, as people do not lean back for long."""
    yaw = quat.swing_twist_y(pelvis)
    if yaw is None or way[1] >= 0:
        return way
    x, y, z = rotate(quat.yaw_quat(-yaw), way)
    most = -LEAN_BACK * y
    return way if z <= most else rotate(quat.yaw_quat(yaw), (x, y, most + LEAN_BACK_SHARE * (z - most)))
