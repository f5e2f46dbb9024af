"""Scale arms that are too short for their user's, so that the hand is where the controller is."""

from __future__ import annotations

from math import exp

import numpy as np
from numpy.typing import NDArray

from glsplat.tracking.solve.body import COLLARS, ELBOWS, SHOULDERS, SPINE1, SPINE2, SPINE3, WRISTS, Body
from glsplat.tracking.solve.quat import Vec, add, clamp, distance, dot, length, mul, rotate, scale, sub
from glsplat.tracking.solve.solution import Solution, Targets

MIN_MISS_M = 1e-5  # a wrist nearer to its hand needs no scaling
MAX_RATE = 8.0  # of an arm's length a second: faster than hands move beyond an arm's reach
LOST_SMOOTHING_S = 0.08  # in which the arm of a lost hand becomes short again
CHAINS = [
    (SPINE1, SPINE2, SPINE3, *arm) for arm in zip(COLLARS, SHOULDERS, ELBOWS, WRISTS, strict=True)
]  # joints from the pelvis to each wrist


class ArmScaling:
    """Lengthen both arms along the line from the shoulder to a hand out of reach.

    The solver's rotations stay as they are: a straight arm that points at the hand. Upper arm and forearm become longer
    by one factor, at most 1 + ``max_extension``.
    """

    def __init__(self, body: Body, max_extension: float) -> None:
        self.body, self.max_extension = body, max_extension
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.extension: list[float] = [0.0, 0.0]  # of the rest length, by which each arm is longer

    def update(self, solution: Solution, targets: Targets, dt: float) -> NDArray[np.float64] | None:
        """Return the joints' translations [55, 3] (metres, ``Pose.translations``), or None where no arm is longer.

        Updates ``solution.reach``. ``dt`` of 0: the first moment of a body.
        """
        reach, out = list(solution.reach), None
        for side, hand in enumerate((targets.left, targets.right)):
            extension = self.extension[side]
            if extension == 0 and (hand is None or reach[side] < MIN_MISS_M):
                continue
            shoulder, wrist = self._shoulder_and_wrist(solution, side)
            arm = sub(wrist, shoulder)
            far = length(arm)
            wanted = 0.0
            if hand is not None and far > 1e-6:
                wanted = clamp(dot(sub(hand, shoulder), arm) / (far * far) - 1, 0.0, self.max_extension)
            if dt <= 0:
                extension = wanted
            elif hand is not None:
                extension = clamp(wanted, extension - MAX_RATE * dt, extension + MAX_RATE * dt)
            else:
                extension = wanted + (extension - wanted) * exp(-dt / LOST_SMOOTHING_S)
            self.extension[side] = extension = extension if extension > 1e-6 else 0.0
            if extension == 0:
                continue
            if out is None:
                out = np.zeros((len(self.body.joints), 3))
            for joint in (ELBOWS[side], WRISTS[side]):
                out[joint] = scale(self.body.offsets[joint], extension)
            if hand is not None:
                reach[side] = distance(sub(hand, shoulder), scale(arm, 1 + extension))
        solution.reach = (reach[0], reach[1])
        return out

    def _shoulder_and_wrist(self, solution: Solution, side: int) -> tuple[Vec, Vec]:
        """Return the positions of both joints."""
        at, turn = solution.pelvis, solution.rotations[0]
        shoulder = at
        for joint in CHAINS[side]:
            at = add(at, rotate(turn, self.body.offsets[joint]))
            turn = mul(turn, solution.rotations[joint])
            if joint == SHOULDERS[side]:
                shoulder = at
        return shoulder, at
