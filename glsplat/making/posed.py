"""An avatar in a pose as plain splats, for programs that know no skinning."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

__all__ = ["posed_splats"]

_DIRECTIONS = 64


def posed_splats(avatar: Avatar, pose: Pose) -> Splats:
    """The avatar's splats under ``pose``, in the avatar's order: float64 linear blend skinning with polar rotations.

    Spherical harmonics of degree 1 and above turn with each splat, so that colours stay where the body has them.
    """
    splats = avatar.splats
    posed = reference.skin(splats, avatar.skin, pose.bones(avatar.skeleton))
    usable = np.linalg.norm(splats.quats, axis=1) > 0
    start = np.where(usable[:, None], splats.quats, [1, 0, 0, 0]).astype(np.float64)
    turned = (Rotation.from_matrix(posed.rotations) * Rotation.from_quat(start[:, [1, 2, 3, 0]])).as_quat()
    quats = np.where(usable[:, None], turned[:, [3, 0, 1, 2]], 0.0)
    sh = splats.sh.astype(np.float64)
    if splats.sh_degree:
        sh = _turned_sh(sh, posed.rotations, splats.sh_degree)
    return Splats.create(
        posed.means, quats, splats.scales, splats.opacities, sh, antialias=splats.antialias, cones=splats.cones
    )


def _turned_sh(sh: reference.F64, rotations: reference.F64, degree: int) -> reference.F64:
    """Coefficients c' with basis(d) c' = basis(R^T d) c for all d: exact, as rotations map each degree to itself."""
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    inverse = np.linalg.pinv(_basis(directions, degree))
    out = np.empty_like(sh)
    for first in range(0, len(sh), 4096):  # bounds the memory
        part = slice(first, first + 4096)
        seen = np.einsum("di,nij->ndj", directions, rotations[part])
        basis = _basis(seen.reshape(-1, 3), degree).reshape(*seen.shape[:2], -1)
        out[part] = np.einsum("kd,ndl,nlc->nkc", inverse, basis, sh[part])
    return out


def _basis(directions: reference.F64, degree: int) -> reference.F64:
    """[D, K] through the evaluation of unit coefficients, made small so that its clamp at zero stays away."""
    count, small = (degree + 1) ** 2, 0.05
    columns = []
    for k in range(count):
        unit = np.zeros((len(directions), count, 3))
        unit[:, k] = small
        columns.append((reference.evaluate_sh(unit, directions, degree)[:, 0] - 0.5) / small)
    return np.stack(columns, axis=1)
