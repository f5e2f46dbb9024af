"""Textures of a mesh from colours of its surface: a point a texel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.paint.texels import texels_of
from glsplat.meshes import MeshPart, RiggedMesh

__all__ = ["SIZES", "baked"]

F64 = NDArray[np.float64]
Colours = Callable[[SurfacePoints], F64]

SIZES = 16, 8192
"""Texels a side that a texture may have."""
_SMALL = 4  # times as many texels a side has the largest part's texture as the others'
_CHUNK = 1 << 15  # points that one core asks for together
_MARGIN = 2  # texels about a part that has a texture of its own


def baked(mesh: RiggedMesh, colours: Colours, size: int = 2048) -> RiggedMesh:
    """``mesh`` with new, opaque textures: ``colours`` gives sRGB [M, 3] in [0, 1] for points of the surface.

    The largest part's texture has ``size`` texels a side and keeps its texture coordinates, which must lie in [0, 1]
    and not overlap.
    Small parts (eyes, the mouth) are spread over textures of their own, a quarter as long on the longer side: packed
    beside the skin, an iris would have five texels. Around the triangles the nearest colour is carried on to the
    edges, so that no lookup mixes in what nobody painted. Raises FormatError for a size out of bounds.
    """
    if not SIZES[0] <= size <= SIZES[1]:
        raise FormatError(f"a texture needs {SIZES[0]} to {SIZES[1]} texels a side, not {size}")
    areas = [float(triangle_areas(mesh.vertices, part.faces).sum()) for part in mesh.parts]
    parts = []
    for part, area in zip(mesh.parts, areas, strict=True):
        if not len(part.faces):
            parts.append(part)
        elif area == max(areas):
            parts.append(_baked(part, part.uv, (size, size), colours))
        else:
            parts.append(_baked(part, *_spread(part.uv, max(size // _SMALL, SIZES[0])), colours))
    return replace(mesh, parts=tuple(parts))


def _baked(part: MeshPart, uv: F64, size: tuple[int, int], colours: Colours) -> MeshPart:
    """The part with a texture of so many texels (width, height)."""
    width, height = size
    texels = texels_of(uv, width, height)
    texture = np.zeros((height * width, 3), np.uint8)
    corners = part.faces.astype(np.intp)

    def coloured(some: slice) -> None:
        rgb = colours(SurfacePoints(corners[texels.face[some]], texels.weights[some]))
        texture[texels.index[some]] = np.rint(np.clip(rgb, 0, 1) * 255)

    map_threads(coloured, [slice(first, first + _CHUNK) for first in range(0, len(texels.index), _CHUNK)])
    painted = np.zeros(height * width, np.uint8)
    painted[texels.index] = 1
    whole = _carried_on(texture.reshape(height, width, 3), painted.reshape(height, width))
    return MeshPart(part.name, part.faces, uv, np.dstack([whole, np.full((height, width), 255, np.uint8)]))


def _carried_on(texture: NDArray[np.uint8], painted: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Every texel that is not painted has the colour of the nearest one that is."""
    if not painted.any():
        return np.full_like(texture, 255)
    _, label = cv2.distanceTransformWithLabels(1 - painted, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    source = np.zeros(int(label.max()) + 1, np.intp)
    known = np.flatnonzero(painted)
    source[label.ravel()[known]] = known
    return texture.reshape(-1, 3)[source[label]]


def _spread(uv: F64, size: int) -> tuple[F64, tuple[int, int]]:
    """Texture coordinates that fill a texture of their own, and its width and height, the longer one ``size``."""
    low, high = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
    extent = np.maximum(high - low, 1e-9)
    sides = [size >> int(np.log2(extent.max() / side).clip(0, np.log2(size / SIZES[0]))) for side in extent]
    margin = _MARGIN / np.array(sides)
    return margin + (uv - low) / extent * (1 - 2 * margin), (sides[0], sides[1])
