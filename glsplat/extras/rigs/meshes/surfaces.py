"""Triangles of a glTF primitive: points at the default weights of their morph targets, and their colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.rigs.meshes.material import Material, material_of
from glsplat.extras.rigs.meshes.vertex_colours import painted
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Instance
from glsplat.formats.gltf.schema import Primitive

_UV, _COLOUR = "texture coordinates (now 0, 0)", "vertex colours (now white)"

Materials = dict[int | None, Material]
"""Materials read from a file, by their index."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A primitive's triangles, in the space in which they are stored."""

    points: F64  # [V, 3]
    faces: NDArray[np.int64]  # [F, 3]
    uv: F64  # [F, 3, 2] v up
    texture: NDArray[np.uint8]  # [H, W, 4]
    name: str


def surface_of(container: Container, instance: Instance, weights: Sequence[float], materials: Materials) -> Surface:
    """Return the triangles of an instance; ``weights`` of its morph targets. Raises FormatError."""
    primitive, where = instance.primitive, instance.name
    points = container.numbers(primitive.attributes["POSITION"], f"{where} POSITION", ("VEC3",)).astype(np.float64)
    for target, weight in zip(primitive.targets, weights, strict=False):
        if weight and "POSITION" in target:
            moved = container.numbers(target["POSITION"], f"{where} morph target", ("VEC3",))
            if moved.shape != points.shape:
                raise FormatError(f"{where}: a morph target needs {len(points)} elements, as POSITION has")
            points = points + weight * moved.astype(np.float64)
    faces = _faces(container, primitive, where, len(points))
    if primitive.material not in materials:  # decode a picture once
        materials[primitive.material] = material_of(container, primitive.material)
    material = materials[primitive.material]
    uv = _corners(container, primitive, where, material, faces, len(points))
    texture = material.texture
    colours = _vertex_colours(container, primitive, where, len(points), material.alpha is None)
    if colours is not None and len(faces):
        uv, texture = painted(faces, colours, uv, material.coloured())
        texture = material.cut_out(texture)
    return Surface(points, faces, uv, texture, material.name or where)


def _faces(container: Container, primitive: Primitive, where: str, count: int) -> NDArray[np.int64]:
    index = np.arange(count)
    if primitive.indices is not None:
        index = container.read(primitive.indices, f"{where} indices", ("SCALAR",))[:, 0].astype(np.int64)
    if len(index) and index.max() >= count:
        raise FormatError(f"{where}: the indices need {count} vertices, and name {index.max()}")
    if primitive.mode == 4:
        if len(index) % 3:
            raise FormatError(f"{where}: the indices need whole triangles, not {len(index)}")
        return index.reshape(-1, 3)
    around = np.stack([index[:-2], index[1:-1], index[2:]], axis=1) if len(index) > 2 else np.empty((0, 3), np.int64)
    if primitive.mode == 5:  # a strip: every second triangle is reversed
        around[1::2] = around[1::2, [1, 0, 2]]
    else:  # a fan
        around[:, 0] = index[0] if len(index) else 0
    return around


def _corners(
    container: Container, primitive: Primitive, where: str, material: Material, faces: NDArray[np.int64], count: int
) -> F64:
    """Return texture coordinates [F, 3, 2], v up, with the material's transform."""
    uv = np.zeros((count, 2))
    if f"TEXCOORD_{material.coordinates}" in primitive.attributes:
        name = f"TEXCOORD_{material.coordinates}"
        stored, _ = container.finite(primitive.attributes[name], f"{where} {name}", ("VEC2",), _UV, 0)
        if len(stored) != count:
            raise FormatError(f"{where}: {name} needs {count} elements, as POSITION has")
        uv = stored.astype(np.float64) @ material.turn[:, :2].T + material.turn[:, 2]
    corner = uv[faces]
    corner[..., 1] = 1 - corner[..., 1]  # glTF's v axis points down
    return corner


def _vertex_colours(container: Container, primitive: Primitive, where: str, count: int, opaque: bool) -> F64 | None:
    """Return linear factors [V, 4], with alpha 1 if ``opaque``; None if all are white."""
    if "COLOR_0" not in primitive.attributes:
        return None
    values, _ = container.finite(primitive.attributes["COLOR_0"], f"{where} COLOR_0", ("VEC3", "VEC4"), _COLOUR, 1)
    if len(values) != count:
        raise FormatError(f"{where}: COLOR_0 needs {count} elements, as POSITION has")
    colours = np.ones((count, 4))
    kept = 3 if opaque else values.shape[1]
    colours[:, :kept] = np.clip(values[:, :kept], 0, 1)
    return None if (colours == 1).all() else colours
