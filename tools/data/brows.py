"""Brows of MakeHuman's people, raised at their inner ends: what slopes down to the nose looks angry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from glsplat.extras.authoring.geometry.nearest import nearest_on
from glsplat.meshes import MeshPart, RiggedMesh

__all__ = ["raised_brows"]


def raised_brows(mesh: RiggedMesh, part: MeshPart, inner: float, outer: float = 0.0) -> RiggedMesh:
    """The mesh whose ``part`` lies so many metres higher at its ends, as far before the skin as it was."""
    skin = next(one for one in mesh.parts if one.name == "body").faces
    own = np.unique(part.faces)
    points = mesh.vertices[own]
    aside = np.abs(points[:, 0])
    share = ((aside - aside.min()) / np.ptp(aside))[:, None]
    lifted = points + (inner * (1 - share) ** 1.5 + outer * share) * np.array([0, 1.0, 0])
    before, after = (nearest_on(mesh.vertices, skin, at)[0] for at in (points, lifted))
    vertices = mesh.vertices.copy()
    vertices[own] = after + (points - before)
    return replace(mesh, vertices=vertices)
