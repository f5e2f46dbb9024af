"""What is known before a picture is looked at: how people stand for it, how they are built, where a camera is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.fit.kinematics import Hinges
from glsplat.extras.authoring.fit.standing.arms import ArmMixture

__all__ = ["CAMERA_HEIGHT", "HINGES", "MEAN", "POSED", "SHAPE_DOUBT", "SPREAD", "STATURE", "TURN_DOUBT", "PosePrior"]

F64 = NDArray[np.float64]

# joint without its side -> axis, mean and standard deviation in radians, as the left side turns. The mean is a relaxed
# A-pose: upper arms some forty degrees below the horizontal, elbows and hips not quite straight.
_SIDED: dict[str, tuple[tuple[int, float, float], ...]] = {
    "hip": ((0, 0.0, 0.08), (1, 0.0, 0.15), (2, 0.07, 0.15)),
    "knee": ((0, 0.0, 0.08),),
    "ankle": ((0, 0.0, 0.10), (2, -0.07, 0.10)),
    "collar": ((1, 0.0, 0.08), (2, 0.0, 0.10)),
    "shoulder": ((0, 0.0, 0.20), (1, 0.0, 0.12), (2, -0.70, 0.50)),
    "elbow": ((1, -0.12, 0.15), (2, 0.0, 0.10)),
    "wrist": ((1, 0.0, 0.12), (2, 0.0, 0.15)),
}
_MIDDLE: dict[str, float] = {"spine1": 0.05, "spine2": 0.05, "spine3": 0.05, "neck": 0.08, "head": 0.12}

_TABLE = [
    (f"{side}_{name}", axis, mean * (-1.0 if side == "right" and axis else 1.0), spread)
    for name, rows in _SIDED.items()
    for side in ("left", "right")
    for axis, mean, spread in rows
] + [(name, axis, 0.0, spread) for name, spread in _MIDDLE.items() for axis in range(3)]

HINGES = Hinges(tuple((name, axis) for name, axis, _, _ in _TABLE))
"""The angles that are fitted."""

MEAN: F64 = np.array([mean for _, _, mean, _ in _TABLE])
"""[D] radians."""

SPREAD: F64 = np.array([spread for _, _, _, spread in _TABLE])
"""[D] radians, one standard deviation."""

TURN_DOUBT: tuple[float, float] = 0.25, 0.05
"""Standard deviation in radians of how a person is turned about the vertical, and of how a camera is rolled."""


SHAPE_DOUBT = 1.3
"""Standard deviation of the numbers of shape: a little more than by the body's making (measured on known people)."""

ARM_BONES: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (("shoulder", "elbow"), ("elbow", "wrist"))
)
"""Upper arms and forearms, from joint to joint."""


@dataclass(frozen=True, eq=False)
class PosePrior:
    """How somebody may stand: what a fit begins with, and what it is drawn back to where a picture says nothing."""

    name: str
    mean: F64  # [D] radians
    spread: F64  # [D] radians, one standard deviation
    turn: float = 0.0  # radians about the vertical, from what the view says
    turn_doubt: float = TURN_DOUBT[0]
    shape_doubt: float = SHAPE_DOUBT
    sleeve: float = 0.008  # share of the figure: an arm's outline that lies farther off the bare arm says little of it
    start: F64 | None = None  # [D] radians where that is not the mean
    arms: ArmMixture | None = None  # what is known of arms instead
    bones: F64 | None = None  # [4, 3] unit vectors in camera axes along ARM_BONES, where a network has said them

    def begun(self) -> F64:
        """[D] radians to begin with."""
        return self.mean if self.start is None else self.start

    def about(self, angles: F64) -> tuple[F64, F64]:
        """Mean [D] and what turns distances from it into standard deviations [D, D], near ``angles`` [D].

        Of a mixture that is its likeliest kind there, one for each arm (max-mixtures: Olson and Agarwal, 2013).
        """
        mean, factor = self.mean.copy(), np.diag(1 / self.spread)
        if self.arms is not None:
            for columns, signs in _ARMS:
                kind = int(self.arms.levels((angles[columns] * signs)[None])[0].argmax())
                mean[columns] = self.arms.means[kind] * signs
                factor[np.ix_(columns, columns)] = self.arms.factors[kind] * signs
        return mean, factor


_ARMS = tuple(
    (
        np.array(
            [HINGES.names.index((f"{side}_shoulder", axis)) for axis in range(3)]
            + [HINGES.names.index((f"{side}_elbow", 1))]
        ),
        np.array([1.0, out, out, out]),
    )
    for side, out in (("left", 1.0), ("right", -1.0))
)  # of each arm its columns, and the signs that make a left one's of them

POSED = PosePrior("posed", MEAN, SPREAD)
"""Somebody who stands for the picture, as they were asked to."""

STATURE: tuple[float, float] = 1.70, 0.10
"""Mean and standard deviation in metres where no height is given."""

CAMERA_HEIGHT: tuple[float, float] = 0.68, 0.06
"""Where a camera is held, mean and standard deviation, in shares of the stature above the soles."""
