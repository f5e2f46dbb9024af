"""Paint hidden sleeves of a patterned shirt with the cloth of its trunk: down the trunk becomes along the arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.front_to_back_transfer import Front
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

F64 = NDArray[np.float64]

_ARM_RADIUS_M = 0.05
_STRIP_M = 0.03, 0.11  # from the trunk's middle: between the buttons and the sides


def cut_sleeves(mesh: RiggedMesh, front: Front, span: tuple[float, float]) -> SurfacePoints:
    """Return [V] for each vertex of an arm in the zero pose a point of the trunk's front with the sleeve's cloth.

    ``span`` is the lowest and the highest metre of the trunk's pattern, which is mirrored at its ends. Along the arm is
    down the trunk, around the arm is across it.
    """
    rest = mesh.vertices
    wanted = rest.copy()
    for side, out in (("left", 1.0), ("right", -1.0)):
        first, last = (mesh.skeleton.joints[JOINT_NAMES.index(f"{side}_{name}")] for name in ("shoulder", "wrist"))
        mine = rest[:, 0] * out > 0
        along = (rest[mine, 0] - first[0]) * out
        bone = first + (along / max(float((last[0] - first[0]) * out), 1e-3))[:, None] * (last - first)
        around = np.arctan2(rest[mine, 2] - bone[:, 2], rest[mine, 1] - bone[:, 1])  # from the top of the arm
        wanted[mine, 0] = out * _fold(_ARM_RADIUS_M * (around + np.pi), *_STRIP_M)
        wanted[mine, 1] = span[1] + span[0] - _fold(span[0] + along, *span)
    return front.points(wanted)


def _fold(along: F64, low: float, high: float) -> F64:
    """Return ``along`` mirrored at two ends until it lies between them."""
    wide = high - low
    return np.asarray(low + wide - np.abs((along - low) % (2 * wide) - wide))
