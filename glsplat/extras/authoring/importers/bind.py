"""Static splats bound to a rigged mesh."""

from __future__ import annotations

import numpy as np

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.nearest import nearest_weights
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

__all__ = ["bind_to_mesh"]


def bind_to_mesh(splats: Splats, mesh: RiggedMesh, reach: float = 0.05, influences: int = 4) -> Avatar:
    """Static splats in the mesh's zero pose, bound with the weights of the nearest surface point.

    ``reach`` in metres: a mesh whose surface is farther than that from more than one splat in a hundred is refused
    (wrong pose, scale or person); a few outliers take the weights of where they are nearest. Raises FormatError.
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
    skin = Skin.create(joints, weights, len(mesh.skeleton), influences)
    return Avatar(splats, mesh.skeleton, skin, dict(mesh.meta))
