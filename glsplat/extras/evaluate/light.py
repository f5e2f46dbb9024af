"""Light a posed mesh as in a photograph: ambient sky and ground, and a far lamp.

The lamp has wrapped Lambert falloff and a soft shadow; there are no highlights. The factors are for
``MeshTruth.render(..., shade=...)``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.camera import Camera, look_at
from glsplat.errors import GlsplatError
from glsplat.extras.authoring.geometry.raster import mesh_picture_and_depth
from glsplat.meshes import RiggedMesh, vertex_normals

_WRAP = 0.15  # of Lambert's cosine: (n . l + wrap) / (1 + wrap)
_FAR, _MAP, _BIAS = 60.0, 768, 0.012  # of the lamp: distance in m, side of its depth map in pixels, depth bias in m
_TAPS = (-2, 0, 2)  # pixels in both directions, for a soft shadow


@dataclass(frozen=True)
class CaptureLight:
    """The light of a capture, linear; 1 makes a white surface look white."""

    towards: tuple[float, float, float]  # to the lamp, of any length, in the world of the posed mesh
    colour: tuple[float, float, float]  # of the lamp
    sky: tuple[float, float, float] = (0.52, 0.53, 0.56)
    ground: tuple[float, float, float] = (0.30, 0.28, 0.26)

    @classmethod
    def of_note(cls, note: Mapping[str, Any]) -> CaptureLight:
        """Return the "light" of a capture's note (direction_to, colour). Raises GlsplatError."""
        try:
            x, y, z = map(float, note["direction_to"])
            red, green, blue = map(float, note["colour"])
        except (KeyError, TypeError, ValueError):
            raise GlsplatError("a capture's light needs direction_to and colour, three numbers each") from None
        if not (np.isfinite([x, y, z, red, green, blue]).all() and any((x, y, z))):
            raise GlsplatError("a capture's light needs a direction that is not zero and finite numbers")
        return cls((x, y, z), (red, green, blue))


def shade_of(mesh: RiggedMesh, vertices: F64, light: CaptureLight) -> F64:
    """Return linear-light factors [V, 3] of a mesh with posed ``vertices`` [V, 3], metres, y up."""
    normals = vertex_normals(vertices, mesh.faces)
    lamp = np.asarray(light.towards, np.float64)
    lamp = lamp / np.linalg.norm(lamp)
    direct = np.maximum((normals @ lamp + _WRAP) / (1 + _WRAP), 0) * _reached(mesh, vertices, lamp)
    sky, ground = np.asarray(light.sky), np.asarray(light.ground)
    return ground + (sky - ground) * (0.5 + 0.5 * normals[:, 1:2]) + direct[:, None] * np.asarray(light.colour)


def _reached(mesh: RiggedMesh, vertices: F64, lamp: F64) -> F64:
    """Return the share of the lamp's light that reaches each vertex [V], by a shadow map."""
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = np.linalg.norm(vertices - middle, axis=1).max() + 0.05
    focal = _MAP / 2 * _FAR / radius
    k = [[focal, 0, _MAP / 2], [0, focal, _MAP / 2], [0, 0, 1]]
    camera = Camera(look_at(middle + _FAR * lamp, middle), k, _MAP, _MAP)
    depth = mesh_picture_and_depth(mesh, vertices, camera, 1)[1]
    seen = vertices @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    column, row = (focal * seen[:, axis] / seen[:, 2] + _MAP / 2 for axis in range(2))
    lit = np.zeros(len(vertices))
    for right in _TAPS:
        for down in _TAPS:
            x, y = (np.clip(place.astype(int), 0, _MAP - 1) for place in (column + right, row + down))
            lit += depth[y, x] + _BIAS > seen[:, 2]
    return lit / len(_TAPS) ** 2
