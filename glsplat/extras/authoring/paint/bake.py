"""Bake the colours of a mesh's surface into its textures: one surface point for each texel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.authoring.compute.threads import map_threads
from glsplat.extras.authoring.geometry.surface_points import SurfacePoints, triangle_areas
from glsplat.extras.authoring.paint.picture_layers.fill import nearest_known
from glsplat.extras.authoring.paint.texels import texels_of
from glsplat.meshes import MeshPart, RiggedMesh

F64 = NDArray[np.float64]
Colours = Callable[[SurfacePoints], F64]

TEXTURE_SIZES_PX = 16, 8192
"""Smallest and largest side of a texture."""
_SMALL_PART_DIVISOR = 4  # side of the largest part's texture over the side of the others'
_CHUNK_TEXELS = 1 << 15  # painted together by one core
_MARGIN_PX = 2  # around a part that has a texture of its own


def bake(mesh: RiggedMesh, colours: Colours, size: int = 2048) -> RiggedMesh:
    """Return ``mesh`` with new, opaque textures: ``colours`` gives sRGB [M, 3] in [0, 1] for points of the surface.

    The largest part's texture has ``size`` texels a side and keeps its texture coordinates, which must lie in [0, 1]
    and not overlap. Small parts (eyes, the mouth) fill textures of their own, a quarter as long on the longer side:
    packed beside the skin, an iris would have five texels. Unpainted texels take the nearest painted colour, so that
    lookups at seams stay clean. Raises FormatError for a size out of bounds.
    """
    if not TEXTURE_SIZES_PX[0] <= size <= TEXTURE_SIZES_PX[1]:
        raise FormatError(f"a texture needs {TEXTURE_SIZES_PX[0]} to {TEXTURE_SIZES_PX[1]} texels a side, not {size}")
    areas = [float(triangle_areas(mesh.vertices, part.faces).sum()) for part in mesh.parts]
    parts = []
    for part, area in zip(mesh.parts, areas, strict=True):
        if not len(part.faces):
            parts.append(part)
        elif area == max(areas):
            parts.append(_bake_part(part, part.uv, (size, size), colours))
        else:
            small = max(size // _SMALL_PART_DIVISOR, TEXTURE_SIZES_PX[0])
            parts.append(_bake_part(part, *_fill_texture(part.uv, small), colours))
    return replace(mesh, parts=tuple(parts))


def _bake_part(part: MeshPart, uv: F64, size: tuple[int, int], colours: Colours) -> MeshPart:
    """Return the part with a texture of ``size`` texels (width, height)."""
    width, height = size
    texels = texels_of(uv, width, height)
    texture = np.full((height * width, 3), 255, np.uint8)
    corners = part.faces.astype(np.intp)

    def paint_chunk(some: slice) -> None:
        rgb = colours(SurfacePoints(corners[texels.face[some]], texels.weights[some]))
        texture[texels.index[some]] = np.rint(np.clip(rgb, 0, 1) * 255)

    firsts = range(0, len(texels.index), _CHUNK_TEXELS)
    map_threads(paint_chunk, [slice(first, first + _CHUNK_TEXELS) for first in firsts])
    painted = np.zeros((height, width), bool)
    painted.flat[texels.index] = True
    extended = texture.reshape(height, width, 3)[nearest_known(painted)]
    return MeshPart(part.name, part.faces, uv, np.dstack([extended, np.full((height, width), 255, np.uint8)]))


def _fill_texture(uv: F64, size: int) -> tuple[F64, tuple[int, int]]:
    """Return texture coordinates that fill a texture, and its width and height; the longer side is ``size``."""
    low, high = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
    extent = np.maximum(high - low, 1e-9)
    sides = [size >> int(np.log2(extent.max() / side).clip(0, np.log2(size / TEXTURE_SIZES_PX[0]))) for side in extent]
    margin = _MARGIN_PX / np.array(sides)
    return margin + (uv - low) / extent * (1 - 2 * margin), (sides[0], sides[1])
