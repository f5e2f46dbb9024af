"""Static splats bound to a rigged mesh."""

from __future__ import annotations

import numpy as np

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.nearest import nearest_weights
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats


def bind_to_mesh(splats: Splats, mesh: RiggedMesh, reach: float = 0.05) -> Avatar:
    """Return an avatar of static splats in the mesh's zero pose, with the weights of the nearest surface points.

    Raises FormatError if more than one splat in a hundred lies farther than ``reach`` metres from the surface (another
    pose, scale or person).
    """
    usable = splats.finite()
    points = np.where(usable[:, None], splats.means, 0).astype(np.float64)
    joints, weights, distance = nearest_weights(mesh, points)
    far = usable & (distance > reach)
    if far.sum() > 0.01 * max(int(usable.sum()), 1):
        raise FormatError(
            f"{int(far.sum())} of {len(splats)} splats lie more than {reach * 100:g} cm from the mesh "
            f"(median {np.median(distance[usable]) * 100:.1f} cm); both need one pose, place and scale"
        )
    skin = Skin.create(joints, weights, len(mesh.skeleton))
    return Avatar(splats, mesh.skeleton, skin, dict(mesh.meta))
