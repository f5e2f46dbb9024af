"""The learned solver: a network guesses torso and feet; inverse kinematics keeps head, hands, ground exact."""

from __future__ import annotations

from dataclasses import replace
from math import acos, exp

from glsplat.tracking.learned.feet import Feet
from glsplat.tracking.learned.hints import Hint, Hints
from glsplat.tracking.learned.network import Network
from glsplat.tracking.solve.arms import Arm
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.hands import Hands
from glsplat.tracking.solve.quat import (
    about,
    clamp,
    cross,
    dot,
    length,
    mul,
    sub,
    swing_twist_y,
    unit,
)
from glsplat.tracking.solve.solution import Solution, Targets, assembled, reaching
from glsplat.tracking.solve.spine import Spine, Torso
from glsplat.tracking.solve.tracked import Pelvis

__all__ = ["LearnedSolver"]

LONGEST_JUMP = 0.7  # seconds; a head out of reach for longer is not a jump
LOWEST_EYE = 0.04  # of the eye height: a head on the floor
SWING = 0.7  # radians at most that the torso swings about the neck to bring the pelvis where it should be


class LearnedSolver:
    """What ``Solver`` asks for. Head and reachable hands are exact, whatever the network says; feet do not slide."""

    def __init__(self, body: Body, network: Network) -> None:
        self.body = body
        self.hints: Hints = Hints(body, network)
        self.spine: Spine = Spine(body)
        self.feet: Feet = Feet(body)
        self.pelvis: Pelvis = Pelvis()  # a tracked one
        self.arms: tuple[Arm, Arm] = (Arm(body, 0), Arm(body, 1))
        self.hands: Hands = Hands(self.arms)
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.hints.reset()
        self.spine.reset()
        self.feet.reset()
        self.pelvis.reset()
        self.hands.reset()
        for arm in self.arms:
            arm.reset()
        self._flight = self._sink = 0.0

    def solve(self, targets: Targets, dt: float) -> Solution:
        """One moment."""
        targets = self._grounded(targets, dt)
        hint = self.hints.update(targets, dt)
        self.pelvis.update(targets.pelvis, targets.pelvis_turn, targets.eye, dt)
        torso = self.pelvis.bring(self.spine, targets.eye, targets.head, self._torso(targets, hint))
        yaw = swing_twist_y(torso.pelvis)
        limbs = self.feet.update(hint.feet, torso.pelvis_at, torso.pelvis, yaw or 0.0, dt, targets.feet, targets.knees)
        arms = reaching(self.arms, self.hands, targets, torso, dt)
        notes = ["head_out_of_reach"] if self._sink > 0.02 else []
        feet = self.feet
        return assembled(torso, limbs, arms, feet.legs, feet.feet, self.body.sole, feet.air, notes)

    def _torso(self, targets: Targets, hint: Hint) -> Torso:
        """The hinted torso, hung on the head, and swung about the neck so that the pelvis is where it was hinted."""
        torso = self.spine.hang(targets.eye, targets.head, hint.pelvis, hint.chest)
        now, goal = unit(sub(torso.pelvis_at, torso.neck_at)), unit(sub(hint.pelvis_at, torso.neck_at))
        axis = cross(now, goal)
        size = length(axis)
        if size < 1e-6:
            return torso
        angle = min(acos(clamp(dot(now, goal), -1.0, 1.0)), SWING)
        swing = about((axis[0] / size, axis[1] / size, axis[2] / size), angle)
        return self.spine.hang(targets.eye, targets.head, mul(swing, hint.pelvis), mul(swing, hint.chest))

    def _grounded(self, targets: Targets, dt: float) -> Targets:
        """The head within the body's reach; as in the analytic solver."""
        slack = self.feet.slack
        self._flight = self._flight + dt if slack < 0 else 0.0
        if self._flight > LONGEST_JUMP or self._sink > 0:
            self._sink = max(0.0, self._sink - (slack - self.feet.tiptoe) * (1 - exp(-dt / 0.25)))
        x, y, z = targets.eye
        sunk = max(y - self._sink, LOWEST_EYE * self.body.eye_height)
        return targets if sunk == y else replace(targets, eye=(x, sunk, z))
