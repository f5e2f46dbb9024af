"""Sleeves of a patterned shirt where no picture shows them: cut from the cloth of its trunk, along the arm as that goes
down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.authoring.geometry.surface_points import SurfacePoints
from glsplat.extras.authoring.paint.front_to_back_transfer import Front
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["cut_sleeves"]

F64 = NDArray[np.float64]

_ROUND = 0.05  # metres of an arm's radius
_ASIDE = 0.03, 0.11  # metres from the trunk's middle that are taken, beside the buttons and before the sides


def cut_sleeves(mesh: RiggedMesh, front: Front, span: tuple[float, float]) -> SurfacePoints:
    """[V] for each vertex of an arm in the zero pose a point of the trunk's front whose cloth may be the sleeve's.

    ``span`` are the lowest and the highest metres of the trunk's pattern; at their ends it goes back. What lies along
    the arm lies down the trunk, what lies around it across.
    """
    rest = mesh.vertices
    wanted = rest.copy()
    for side, out in (("left", 1.0), ("right", -1.0)):
        first, last = (mesh.skeleton.joints[JOINT_NAMES.index(f"{side}_{name}")] for name in ("shoulder", "wrist"))
        mine = rest[:, 0] * out > 0
        along = (rest[mine, 0] - first[0]) * out
        bone = first + (along / max(float((last[0] - first[0]) * out), 1e-3))[:, None] * (last - first)
        around = np.arctan2(rest[mine, 2] - bone[:, 2], rest[mine, 1] - bone[:, 1])  # from the top of the arm
        wanted[mine, 0] = out * _folded(_ROUND * (around + np.pi), *_ASIDE)
        wanted[mine, 1] = span[1] + span[0] - _folded(span[0] + along, *span)
    return front.points(wanted)


def _folded(along: F64, low: float, high: float) -> F64:
    """``along``, going to and fro between two ends."""
    wide = high - low
    return np.asarray(low + wide - np.abs((along - low) % (2 * wide) - wide))
