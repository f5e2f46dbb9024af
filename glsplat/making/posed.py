"""An avatar in a pose as plain splats, for programs that know no skinning."""

from __future__ import annotations

import numpy as np

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.rotations import matrix_quaternions, quaternion_product, sh_rotations
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats

__all__ = ["posed_splats"]


def posed_splats(avatar: Avatar, pose: Pose) -> Splats:
    """The avatar's splats under ``pose``, in the avatar's order: float64 linear blend skinning with polar rotations.

    Spherical harmonics of degree 1 and above turn with each splat, so that colours stay where the body has them.
    """
    splats = avatar.splats
    posed = reference.skin(splats, avatar.skin, pose.bones(avatar.skeleton))
    sh = splats.sh.astype(np.float64)
    if splats.sh_degree:
        for first in range(0, len(sh), 4096):  # bounds the memory
            part = slice(first, first + 4096)
            sh[part] = sh_rotations(posed.rotations[part], splats.sh_degree) @ sh[part]
    quats = quaternion_product(matrix_quaternions(posed.rotations), splats.quats)
    return Splats.create(
        posed.means, quats, splats.scales, splats.opacities, sh, antialias=splats.antialias, cones=splats.cones
    )
