"""Priors of the fit: poses of people in pictures, with a mixture for their arms, their shape, the camera's height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from glsplat.arrays import F64
from glsplat.extras.authoring.fit.kinematics import Hinges
from glsplat.extras.authoring.fit.landmarks import read_table
from glsplat.rotations import matrix_quaternions, quaternion_vectors, unit_vectors

_MIN_BEND_SINE = 0.05  # of an elbow whose axis is determined
# joint without its side -> axis, mean and standard deviation in radians, for the left side. The mean is a relaxed
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
"""The fitted angles (D)."""
MEAN: F64 = np.array([mean for _, _, mean, _ in _TABLE])
"""[D] radians."""
SPREAD: F64 = np.array([spread for _, _, _, spread in _TABLE])
"""[D] radians, one standard deviation."""
TURN_SD_RAD = 0.25
"""Standard deviation of the person's turn about the vertical."""
ROLL_SD_RAD = 0.05
"""Standard deviation of the camera's roll."""
SHAPE_SD = 1.3
"""Standard deviation of the shape parameters, measured on known people; a little larger than the body's own unit."""
ARM_BONES: tuple[tuple[str, str], ...] = tuple(
    (f"{side}_{upper}", f"{side}_{lower}")
    for side in ("left", "right")
    for upper, lower in (("shoulder", "elbow"), ("elbow", "wrist"))
)
"""Upper arms and forearms, from joint to joint."""


@dataclass(frozen=True, eq=False)
class ArmMixture:
    """K components over a left arm: [shoulder's axis-angle (3), elbow about y], radians."""

    shares: F64  # [K] sum to one
    means: F64  # [K, 4]
    covariances: F64  # [K, 4, 4]

    @cached_property
    def whitening(self) -> F64:
        """[K, 4, 4] from distances to the mean to standard deviations."""
        return np.linalg.inv(np.linalg.cholesky(self.covariances))

    def log_densities(self, arms: F64) -> F64:
        """Return each component's log density [N, K] at ``arms`` [N, 4], up to a constant."""
        off = np.einsum("kij,nkj->nki", self.whitening, arms[:, None] - self.means)
        narrow = np.log(np.linalg.det(self.whitening))
        return np.asarray(np.log(self.shares) + narrow - 0.5 * (off**2).sum(-1))

    @staticmethod
    def angles_of(upper: F64, fore: F64) -> F64:
        """Return the angles [N, 4] of left arms whose bones point along ``upper`` and ``fore`` [N, 3], in collar axes.

        The elbow bends about y alone. A straight arm's twist is undetermined; its elbow points back.
        """
        first, second = unit_vectors(upper), unit_vectors(fore)
        bend = np.arccos((first * second).sum(axis=1).clip(-1, 1))
        normal = np.cross(second, first)  # a left elbow turns x towards z by a negative angle about y
        flat = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = unit_vectors(np.where(flat > _MIN_BEND_SINE, normal, np.cross((0.0, 0.0, 1.0), first)), 1e-9)
        frames = np.stack([first, normal, np.cross(first, normal)], axis=2)
        return np.concatenate([quaternion_vectors(matrix_quaternions(frames)), -bend[:, None]], axis=1)


@lru_cache(maxsize=1)
def arm_mixture() -> ArmMixture:
    """Return the embedded mixture (arm_mixture.json), made by tools/data/arms.py."""
    kinds = read_table("arm_mixture.json", "kinds")
    shares = np.array([kind["share"] for kind in kinds])
    means, covariances = (np.array([kind[key] for kind in kinds]) for key in ("mean", "spread"))
    return ArmMixture(shares / shares.sum(), means, covariances)


@dataclass(frozen=True, eq=False)
class PosePrior:
    """The prior of a pose: the start of a fit, and the distribution of its angles."""

    name: str
    mean: F64  # [D] radians
    spread: F64  # [D] radians, one standard deviation
    turn: float = 0.0  # radians about the vertical, relative to the view's
    turn_sd: float = TURN_SD_RAD
    shape_sd: float = SHAPE_SD
    sleeve: float = 0.008  # fraction of the person's height: scale of an arm's distance from its outline
    start: F64 | None = None  # [D] radians, if not the mean
    arms: ArmMixture | None = None  # replaces the arms' distribution
    bones: F64 | None = None  # [4, 3] unit vectors in camera axes along ARM_BONES, from a network

    def initial(self) -> F64:
        """Return the angles [D] at the start of a fit, radians."""
        return self.mean if self.start is None else self.start

    def near(self, angles: F64) -> tuple[F64, F64]:
        """Return the mean [D] and whitening matrix [D, D] of the normal distribution near ``angles`` [D].

        A mixture contributes its most likely component for each arm (max-mixtures: Olson and Agarwal, 2013).
        """
        mean, factor = self.mean.copy(), np.diag(1 / self.spread)
        if self.arms is not None:
            for columns, signs in _ARMS:
                kind = int(self.arms.log_densities((angles[columns] * signs)[None])[0].argmax())
                mean[columns] = self.arms.means[kind] * signs
                factor[np.ix_(columns, columns)] = self.arms.whitening[kind] * signs
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
)  # for each arm its columns, and the signs that mirror it to the left


POSED = PosePrior("posed", MEAN, SPREAD)
"""A person in the requested pose."""


STATURE_M: tuple[float, float] = 1.70, 0.10
"""Mean and standard deviation if no height is given."""


CAMERA_HEIGHT: tuple[float, float] = 0.68, 0.06
"""Mean and standard deviation of the camera's height above the soles, in fractions of the stature."""
