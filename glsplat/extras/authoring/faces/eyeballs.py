"""Fit spheres to the eyeballs of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.visibility import EYES
from glsplat.meshes import RiggedMesh
from glsplat.skinning.skin import strongest_joint

_MIN_VERTICES = 16  # of an eye


@dataclass(frozen=True, slots=True)
class Eyeball:
    """The sphere of an eyeball."""

    joint: str
    centre: F64  # [3] metres
    radius: float  # metres


def fit_eyeballs(mesh: RiggedMesh, *parts: str) -> list[Eyeball]:
    """Return spheres fitted to the vertices of each eye's joint in the ``parts``. Raises FormatError without both."""
    names, out = mesh.skeleton.names, []
    every = [one.faces.reshape(-1) for one in mesh.parts if one.name in parts]
    used = np.unique(np.concatenate([np.empty(0, np.int32), *every]))
    strongest = strongest_joint(mesh.joints, mesh.weights)
    for joint in EYES:
        mine = used[strongest[used] == names.index(joint)] if joint in names else used[:0]
        if len(mine) < _MIN_VERTICES:
            raise FormatError(f"{' and '.join(parts)} need vertices bound to {joint}")
        points = mesh.vertices[mine]
        system = np.concatenate([2 * points, np.ones((len(points), 1))], axis=1)
        solution = np.linalg.lstsq(system, (points**2).sum(axis=1), rcond=None)[0]
        out.append(Eyeball(joint, solution[:3], float(np.sqrt(solution[3] + solution[:3] @ solution[:3]))))
    return out
