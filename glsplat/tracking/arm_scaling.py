"""Arms that are too short for their user's: a little longer, so that the hand is where the controller is."""

from __future__ import annotations

from math import exp, sqrt

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.solve.body import COLLARS, ELBOWS, SHOULDERS, SPINE1, SPINE2, SPINE3, WRISTS, Body
from glsplat.tracking.solve.quat import Vec, mul, rotate
from glsplat.tracking.solve.solution import Solution, Targets

__all__ = ["Stretch"]

_SPINE = SPINE1, SPINE2, SPINE3
MISSED = 1e-5  # metres; a wrist nearer than that is where it should be
RATE = 8.0  # of its length a second: more than hands move beyond an arm's reach
LOST = 0.08  # seconds in which the arm of a hand that is lost gives up its stretch


class Stretch:
    """How much longer both arms are than at rest. A wrist beyond them is met along the line from the shoulder.

    The solver's rotations stay as they are: a straight arm that points at the hand. Upper arm and forearm become longer
    by one factor, at most 1 + ``most``.
    """

    def __init__(self, body: Body, most: float) -> None:
        self.body, self.most = body, most
        self.extra: list[float] = [0.0, 0.0]
        self._chains = [(*_SPINE, *joints) for joints in zip(COLLARS, SHOULDERS, ELBOWS, WRISTS, strict=True)]

    def reset(self) -> None:
        """Forget the past."""
        self.extra = [0.0, 0.0]

    def step(self, solution: Solution, targets: Targets, dt: float) -> NDArray[np.float64] | None:
        """[55, 3] translations of the joints (metres, ``Pose.translations``), or None; ``solution.reach`` is brought up
        to date. ``dt`` of 0: no past."""
        reach, out = list(solution.reach), None
        for side, hand in enumerate((targets.left, targets.right)):
            extra = self.extra[side]
            if extra == 0 and (hand is None or reach[side] < MISSED):
                continue
            shoulder, wrist = self._places(solution, side)
            arm = _minus(wrist, shoulder)
            far = sqrt(_dot(arm, arm))
            wanted = 0.0
            if hand is not None and far > 1e-6:
                wanted = min(max(_dot(_minus(hand, shoulder), arm) / (far * far) - 1, 0.0), self.most)
            if dt <= 0:
                extra = wanted
            elif hand is not None:
                extra = min(max(wanted, extra - RATE * dt), extra + RATE * dt)
            else:
                extra = wanted + (extra - wanted) * exp(-dt / LOST)
            self.extra[side] = extra = extra if extra > 1e-6 else 0.0
            if extra == 0:
                continue
            if out is None:
                out = np.zeros((len(self.body.joints), 3))
            for joint in (ELBOWS[side], WRISTS[side]):
                out[joint] = [extra * value for value in self.body.offsets[joint]]
            if hand is not None:
                x, y, z = _minus(hand, shoulder)
                k = 1 + extra
                reach[side] = sqrt((x - k * arm[0]) ** 2 + (y - k * arm[1]) ** 2 + (z - k * arm[2]) ** 2)
        solution.reach = (reach[0], reach[1])
        return out

    def _places(self, solution: Solution, side: int) -> tuple[Vec, Vec]:
        """Shoulder and wrist joint in the world."""
        at, turn = solution.pelvis, solution.rotations[0]
        shoulder = at
        for joint in self._chains[side]:
            x, y, z = rotate(turn, self.body.offsets[joint])
            at = (at[0] + x, at[1] + y, at[2] + z)
            turn = mul(turn, solution.rotations[joint])
            if joint == SHOULDERS[side]:
                shoulder = at
        return shoulder, at


def _minus(a: Vec, b: Vec) -> Vec:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _dot(a: Vec, b: Vec) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
