"""How people who stand hold their arms: a mixture of Gaussians that captured motion has taught."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import matrix_quaternions, quaternion_vectors, unit_vectors

__all__ = ["ArmMixture", "arm_mixture"]

F64 = NDArray[np.float64]

_BENT = 0.05  # sine of the elbow from which on its axis is known


@dataclass(frozen=True, eq=False)
class ArmMixture:
    """K kinds of how a left arm is held: [shoulder's axis-angle (3), elbow about y], radians."""

    shares: F64  # [K] sum to one
    means: F64  # [K, 4]
    spreads: F64  # [K, 4, 4] covariances

    @cached_property
    def factors(self) -> F64:
        """[K, 4, 4] what turns a distance from the mean into standard deviations."""
        return np.linalg.inv(np.linalg.cholesky(self.spreads))

    def levels(self, arms: F64) -> F64:
        """[N, K] logarithms of each kind's density at ``arms`` [N, 4], but for a constant."""
        off = np.einsum("kij,nkj->nki", self.factors, arms[:, None] - self.means)
        narrow = np.log(np.linalg.det(self.factors))
        return np.asarray(np.log(self.shares) + narrow - 0.5 * (off**2).sum(-1))

    @staticmethod
    def angles_of(upper: F64, fore: F64) -> F64:
        """[N, 4] of left arms whose bones point so [N, 3] in the collar's frame.

        The elbow bends about y alone; a straight arm, whose turn about itself nothing shows, has its elbow look back.
        """
        first, second = unit_vectors(upper), unit_vectors(fore)
        bend = np.arccos((first * second).sum(axis=1).clip(-1, 1))
        normal = np.cross(second, first)  # a left elbow turns x towards z by a negative angle about y
        flat = np.linalg.norm(normal, axis=1, keepdims=True)
        normal = unit_vectors(np.where(flat > _BENT, normal, np.cross((0.0, 0.0, 1.0), first)), 1e-9)
        frames = np.stack([first, normal, np.cross(first, normal)], axis=2)
        return np.concatenate([quaternion_vectors(matrix_quaternions(frames)), -bend[:, None]], axis=1)


@lru_cache(maxsize=1)
def arm_mixture() -> ArmMixture:
    """The embedded one (arm_mixture.json in the folder above), made by tools/data/arms.py."""
    text = (resources.files("glsplat.extras.authoring.fit") / "arm_mixture.json").read_text(encoding="utf-8")
    kinds = json.loads(text)["kinds"]
    shares = np.array([kind["share"] for kind in kinds])
    means, spreads = (np.array([kind[key] for kind in kinds]) for key in ("mean", "spread"))
    return ArmMixture(shares / shares.sum(), means, spreads)
