"""An avatar in a pose as static splats, and splats as float64 arrays for rasterizers on the CPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glsplat import reference
from glsplat.arrays import F64
from glsplat.avatar import Avatar
from glsplat.rotations import matrix_quaternions, quaternion_matrices, quaternion_product, sh_rotations
from glsplat.skinning.pose import Pose
from glsplat.splats import SH_C0, Splats


class PosedSplats(NamedTuple):
    """N splats where they are drawn, float64 and contiguous."""

    means: F64  # [N, 3]
    rotations: F64  # [N, 3, 3]
    scales: F64  # [N, 3]
    opacities: F64  # [N]; 0 leaves a splat out
    rgb: F64  # [N, 3]


def drawable(splats: Splats) -> NDArray[np.bool_]:
    """Return True [N] for splats that the renderer draws: finite, with a rotation."""
    return splats.finite() & (np.abs(splats.quats).max(axis=1, initial=0) > 0)


def axes_of(splats: Splats) -> F64:
    """Return the principal axes as columns [N, 3, 3]; as in the renderer, a negative scale flips its axis."""
    finite = np.asarray(np.isfinite(splats.quats).all(axis=1))[:, None]
    sign = np.where(splats.scales < 0, -1.0, 1.0)
    return quaternion_matrices(np.where(finite, splats.quats, (1, 0, 0, 0))) * sign[:, None, :]


def placed(splats: Splats) -> PosedSplats:
    """Return splats where they lie, in their colours of degree 0; splats that cannot be drawn get opacity 0."""
    usable = drawable(splats)
    colours = np.where(usable[:, None], splats.sh[:, 0], 0).astype(np.float64) * SH_C0 + 0.5
    return PosedSplats(
        np.where(usable[:, None], splats.means, 0).astype(np.float64),
        axes_of(splats),
        np.where(usable[:, None], np.abs(splats.scales), 1).astype(np.float64),
        np.where(usable, np.clip(splats.opacities, 0, 1), 0).astype(np.float64),
        colours.clip(0, 1),
    )


def posed_splats(avatar: Avatar, pose: Pose) -> Splats:
    """Return the avatar's splats under ``pose``, in its order: float64 linear blend skinning with polar rotations.

    Spherical harmonics of degree 1 and above turn with each splat. With an expression, bent splats get the axes of
    their new covariance, and cones are dropped.
    """
    splats = avatar.splats
    weights = avatar.weights(pose)
    bones = pose.bones(avatar.skeleton)
    posed = reference.skin(splats, avatar.skin, bones, shapes=avatar.shapes, expression=weights)
    sh = splats.sh.astype(np.float64)
    if splats.sh_degree:
        for first in range(0, len(sh), 4096):  # bounds the memory
            part = slice(first, first + 4096)
            sh[part] = sh_rotations(posed.rotations[part], splats.sh_degree) @ sh[part]
    quats = quaternion_product(matrix_quaternions(posed.rotations), splats.quats)
    scales, cones = splats.scales, splats.cones
    if weights is not None and avatar.shapes is not None:
        bent = np.diff(avatar.shapes.starts) > 0
        axes, sizes, _ = np.linalg.svd(np.where(np.isfinite(posed.shapes[bent]), posed.shapes[bent], 0))
        axes[:, :, 2] *= np.linalg.det(axes)[:, None]
        quats[bent], scales, cones = matrix_quaternions(axes), np.array(scales), None  # cones are along the old axes
        scales[bent] = sizes
    surface = None if splats.surface is None else splats.surface.turned(posed.rotations)
    return Splats.create(
        posed.means, quats, scales, splats.opacities, sh, antialias=splats.antialias, cones=cones, surface=surface
    )
