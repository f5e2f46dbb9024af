"""Let cloth bridge the cleft of the seat, which the outline of a front does not show."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from glsplat.arrays import F64
from glsplat.extras.authoring.body.open_body import Body
from glsplat.extras.authoring.body.segments import trunk_vertices
from glsplat.meshes import RiggedMesh
from glsplat.skinning.smplx import JOINT_NAMES

_ROWS_M = np.arange(-0.02, 0.17, 0.01)  # above the hip joints: from the fold of the seat to the small of the back
_BRIDGED_FRACTION = 0.75  # of the cleft's depth: cloth of twelve generated people leaves 1 cm of 3.5 cm
_FADES_M = (-0.02, 0.03, 0.12, 0.16), (0.0, 1.0, 1.0, 0.0)  # above the hip joints: lower, inner thighs would show
_BEHIND_M = 0.02, 0.06  # behind the pelvis, where the move begins and is complete: flanks and inner thighs stay
_MAX_MOVE_M = 0.04


def with_bridged_seat(body: Body, mesh: RiggedMesh) -> F64:
    """Return the vertices [V, 3] of the dressed body ``mesh`` in the zero pose, moved back in the cleft of the seat.

    Each row's back moves towards its convex hull across, so fronts keep their outlines.
    """
    rest, joints = mesh.vertices, mesh.skeleton.joints
    hips = np.array([JOINT_NAMES.index(f"{side}_hip") for side in ("left", "right")])
    middle, hip, depth = joints[JOINT_NAMES.index("pelvis")][0], joints[hips, 1].mean(), joints[hips, 2].mean()
    worn = body.skin & (trunk_vertices(body) | np.isin(body.part, hips))
    place = rest - (middle, hip, depth)
    faces = mesh.faces[worn[mesh.faces].all(axis=1)]
    ends = place[np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])]
    moved = np.flatnonzero(
        worn & (place[:, 2] < -_BEHIND_M[0]) & (place[:, 1] > _ROWS_M[0]) & (place[:, 1] < _ROWS_M[-1])
    )
    x, y, z = place[moved].T
    side = np.sign(body.vertices[moved, 0])
    x = side * np.maximum(side * x, 0)  # buttocks that cross each other would fold when they move
    hulls = np.array([_hull(ends, row, x) for row in _ROWS_M])  # [rows, K]
    step = (y - _ROWS_M[0]) / (_ROWS_M[1] - _ROWS_M[0])
    low = step.astype(np.intp).clip(0, len(_ROWS_M) - 2)
    each = np.arange(len(moved))
    hull = hulls[low, each] + (step - low) * (hulls[low + 1, each] - hulls[low, each])
    share = _BRIDGED_FRACTION * np.interp(y, *_FADES_M) * np.interp(-z, _BEHIND_M, (0, 1))
    out = rest.copy()
    out[moved, 0] += (share > 0) * (x - place[moved, 0])
    out[moved, 2] += (share * (hull - z)).clip(-_MAX_MOVE_M, 0)
    return out


def _hull(ends: F64, row: float, x: F64) -> F64:
    """Return the depths [K] at ``x`` [K] of the hull behind the cut of edges ``ends`` [E, 2, 3] at height ``row``."""
    first, second = ends[:, 0], ends[:, 1]
    cut = (first[:, 1] < row) != (second[:, 1] < row)
    first, second = first[cut], second[cut]
    points = first + ((row - first[:, 1]) / (second[:, 1] - first[:, 1]))[:, None] * (second - first)
    points = points[points[:, 2] < 0][:, ::2]
    if len(points) < 3:
        return np.zeros(len(x))
    sides = ConvexHull(points).equations  # of lines: outward normals, and offsets
    across, behind, offset = sides[sides[:, 1] < 0].T[:, :, None]
    return np.asarray((-(across * x + offset) / behind).max(axis=0))
