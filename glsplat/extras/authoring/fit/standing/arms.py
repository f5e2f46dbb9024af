"""A mixture of Gaussians over the arms of standing people, learned from captured motion."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources

import numpy as np

from glsplat.arrays import F64
from glsplat.rotations import matrix_quaternions, quaternion_vectors, unit_vectors

_MIN_BEND_SINE = 0.05  # of an elbow whose axis is determined


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
    """Return the embedded mixture (arm_mixture.json in the folder above), made by tools/data/arms.py."""
    text = (resources.files("glsplat.extras.authoring.fit") / "arm_mixture.json").read_text(encoding="utf-8")
    kinds = json.loads(text)["kinds"]
    shares = np.array([kind["share"] for kind in kinds])
    means, covariances = (np.array([kind[key] for kind in kinds]) for key in ("mean", "spread"))
    return ArmMixture(shares / shares.sum(), means, covariances)
