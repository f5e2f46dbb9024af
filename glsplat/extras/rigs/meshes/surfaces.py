"""Triangles of a glTF primitive: points at the default weights of their morph targets, and their base colours.

Base colours have factor, texture, texture transform and alpha cut-off; vertex colours are baked into a texture, a small
square of texels for each triangle. Morph targets and VRM expressions become expressions under ARKit's names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.formats.texture import decode_texture
from glsplat.extras.rigs.gltf import face_binds
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.morphs import read_morphs
from glsplat.formats.gltf.nodes import Instance
from glsplat.formats.gltf.schema import Accessor, Primitive
from glsplat.meshes import MeshPart, Morphs
from glsplat.pictures import to_linear, to_srgb
from glsplat.skinning.expression import ARKIT, arkit_name

_PLAIN = 4  # texels a side of a texture of one colour
_WEBP, _TRANSFORM, _BASIS = "EXT_texture_webp", "KHR_texture_transform", "KHR_texture_basisu"

_LEAST, _UNEVEN, _MOST = 3, 9, 24  # texels a side of a square: fewest, for uneven colours, most
_EVEN = 0.15  # range of factors in a triangle below which the fewest suffice
_SIDE = 8192  # texels a side of the texture

_UV, _COLOUR = "texture coordinates (now 0, 0)", "vertex colours (now white)"


@dataclass(frozen=True, eq=False)
class Material:
    """The unlit colours of a surface."""

    texture: NDArray[np.uint8]  # [H, W, 4]; alpha below 128 is cut out
    coordinates: int  # TEXCOORD_n
    turn: NDArray[np.float64]  # [2, 3] of glTF's texture coordinates (KHR_texture_transform)
    name: str
    alpha: NDArray[np.uint8] | None = None  # [H, W] times the factor, before the cut; None: opaque
    cut: float = 127.5  # of 255; alpha below it is cut out

    def coloured(self) -> NDArray[np.uint8]:
        """Return the texture [H, W, 4] with the alpha that vertices' colours multiply; ``cut_out`` follows."""
        return self.texture if self.alpha is None else np.dstack([self.texture[..., :3], self.alpha])

    def cut_out(self, texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a texture made from ``coloured``, with its cut-off at one half."""
        return texture if self.alpha is None else np.dstack([texture[..., :3], _halved(texture[..., 3], self.cut)])


def material_of(container: Container, index: int | None) -> Material:
    """Return the base colour of a material; white without one. Raises FormatError naming the material."""
    gltf = container.gltf
    try:
        entry: Any = gltf.materials[index] if index is not None else {}
        base = entry.get("pbrMetallicRoughness", {})
        factor = np.array(base.get("baseColorFactor", (1, 1, 1, 1)), np.float64)
        if factor.shape != (4,) or not np.isfinite(factor).all():
            raise ValueError
        image, coordinates, turn = np.full((_PLAIN, _PLAIN, 4), 255, np.uint8), 0, np.eye(2, 3)
        if "baseColorTexture" in base:
            used = base["baseColorTexture"]
            turn, coordinates = _transform(used.get("extensions", {}).get(_TRANSFORM, {}), int(used.get("texCoord", 0)))
            image = _image(container, gltf.textures[used["index"]])
        name, mode = str(entry.get("name") or ""), entry.get("alphaMode", "OPAQUE")
        if mode == "OPAQUE":
            texture = np.concatenate([_tinted(image, factor), np.full((*image.shape[:2], 1), 255, np.uint8)], axis=-1)
            return Material(texture, coordinates, turn, name)
        alpha = np.rint(np.clip(np.arange(256) * float(factor[3]), 0, 255)).astype(np.uint8)[image[..., 3]]
        cut = float(entry.get("alphaCutoff", 0.5)) * 255 if mode == "MASK" else 127.5
        return Material(np.dstack([_tinted(image, factor), _halved(alpha, cut)]), coordinates, turn, name, alpha, cut)
    except (AttributeError, KeyError, IndexError, OverflowError, TypeError, ValueError):
        raise FormatError(f"material {index} is malformed") from None


def _halved(alpha: NDArray[np.uint8], cut: float) -> NDArray[np.uint8]:
    """Shift alpha so that its cut-off moves from ``cut`` of 255 to one half."""
    return np.rint(np.clip(127.5 + (np.arange(256) - cut), 0, 255)).astype(np.uint8)[alpha]


def _tinted(image: NDArray[np.uint8], factor: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the image [H, W, 3] times the linear factor."""
    out = image[..., :3]
    if (factor[:3] != 1).any():
        table = to_linear(np.arange(256) / 255.0)
        out = out.copy()
        for channel in range(3):
            values = to_srgb(np.clip(table * factor[channel], 0, 1))
            out[..., channel] = np.rint(values * 255).astype(np.uint8)[image[..., channel]]
    return out


def _transform(entry: Mapping[str, Any], coordinates: int) -> tuple[NDArray[np.float64], int]:
    """Parse KHR_texture_transform to a matrix [2, 3] and its set of coordinates; rotation is counter-clockwise."""
    angle = float(entry.get("rotation", 0.0))
    offset, scale = (
        np.array(entry.get(name, default), np.float64) for name, default in (("offset", (0, 0)), ("scale", (1, 1)))
    )
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]]) * scale  # columns are scaled: scale first
    if offset.shape != (2,) or not np.isfinite(turn).all() or not np.isfinite(offset).all():
        raise ValueError
    return np.column_stack([turn, offset]), int(entry.get("texCoord", coordinates))


def _image(container: Container, texture: Mapping[str, Any]) -> NDArray[np.uint8]:
    more = texture.get("extensions", {})
    source = more[_WEBP]["source"] if _WEBP in more else texture.get("source")
    if source is None:
        kind = f" ({_BASIS})" if _BASIS in more else ""
        raise FormatError(
            f"a texture is in a format of graphics cards{kind}; "
            "unpack it: npx @gltf-transform/cli ktxdecompress IN.glb OUT.glb"
        )
    return decode_texture(_bytes_of(container, container.gltf.images[source]), f"image {source}")


def _bytes_of(container: Container, image: Mapping[str, Any]) -> bytes:
    if "bufferView" in image:
        view = container.gltf.buffer_views[image["bufferView"]]
        # an accessor of bytes, so that the bounds are checked in one place
        container.gltf.accessors.append(
            Accessor(component_type=5121, count=view.byte_length, type="SCALAR", buffer_view=image["bufferView"])
        )
        return container.read(len(container.gltf.accessors) - 1, "image", ("SCALAR",)).tobytes()
    return container.fetched(str(image["uri"]), "image")


def painted(
    faces: NDArray[np.int64],  # [F, 3]
    colours: F64,  # [V, 4] linear factors
    uv: F64,  # [F, 3, 2] of the texture, v up
    texture: NDArray[np.uint8],  # [H, W, 4]
) -> tuple[F64, NDArray[np.uint8]]:
    """Return coordinates [F, 3, 2] into a new texture: ``texture`` times the linearly interpolated colours."""
    count = len(faces)
    side = _texels(uv, texture, colours[faces])
    across = int(np.ceil(np.sqrt(count)))
    down = -(-count // across)
    steps = np.arange(side) / (side - 1)
    b, c = np.meshgrid(steps, steps)  # of the second and the third corner; extrapolated beyond the triangle
    weights = np.stack([1 - b - c, b, c], axis=-1)  # [S, S, 3]
    out = np.empty((down, side, across, side, 4), np.uint8)
    part = MeshPart("", faces.astype(np.int32), uv, texture)
    plain = bool((texture == texture[:1, :1]).all())
    for row in range(down):
        mine = slice(row * across, min((row + 1) * across, count))
        factor = np.clip(np.einsum("ijk,fkc->fijc", weights, colours[faces[mine]]), 0, 1)
        seen = texture[0, 0] / 255.0 if plain else part.sample(np.einsum("ijk,fkc->fijc", weights, uv[mine]))
        seen = np.broadcast_to(seen, factor.shape)
        values = np.concatenate(
            [to_srgb(to_linear(seen[..., :3]) * factor[..., :3]), seen[..., 3:] * factor[..., 3:]], axis=-1
        )
        out[row] = 255
        out[row, :, : len(values)] = np.rint(values * 255).astype(np.uint8).transpose(1, 0, 2, 3)
    column, line = np.arange(count) % across, np.arange(count) // across
    corner = np.stack([column, line], axis=1)[:, None] * side + 0.5 + np.array([[0, 0], [1, 0], [0, 1]]) * (side - 1)
    corner = corner / (across * side, down * side)
    corner[..., 1] = 1 - corner[..., 1]
    return corner, out.reshape(down * side, across * side, 4)


def _texels(uv: F64, texture: NDArray[np.uint8], corners: F64) -> int:
    """Return texels a side of a square: about the triangles' present resolution, and enough for their colours.

    Colours between texels are mixed in sRGB, not in linear light.
    """
    spread = float(np.percentile(np.ptp(corners, axis=1).max(axis=1), 95))
    least = _LEAST if spread < _EVEN else _UNEVEN
    count = len(corners)
    size = np.array(texture.shape[1::-1])
    edges = np.linalg.norm((uv - np.roll(uv, 1, axis=1)) * size, axis=-1)
    wanted = int(np.clip(np.ceil(np.percentile(edges, 90)) + 1, least, _MOST)) if texture.shape[0] > 4 else least
    return max(_LEAST, min(wanted, _SIDE // max(int(np.ceil(np.sqrt(count))), 1)))


Materials = dict[int | None, Material]  # materials read from a file, by their index


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


class Faces:
    """Collects expressions, primitive by primitive."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self._said = face_binds(container.gltf)
        self._found: dict[str, list[tuple[NDArray[np.integer], NDArray[np.floating]]]] = {}

    def add(self, instance: Instance, node: int, first: int, linear: F64) -> int:
        """Add an instance's expressions; at ``node``, its vertices start at ``first`` and were moved by ``linear``
        [3, 3] or [V, 3, 3]. Returns the number of its targets in no expression. Raises FormatError."""
        primitive, mesh = instance.primitive, instance.node.mesh
        if not primitive.targets or mesh is None:
            return 0
        morphs = read_morphs(self._container, item(self._container.gltf.meshes, mesh, "mesh"), primitive)
        if not np.isfinite(morphs.offsets).all():
            raise FormatError(f"{instance.name}: the morph targets need finite offsets, found NaN or infinity")
        used: set[int] = set()
        for name, targets in self._targets(morphs, node, mesh).items():
            for target, weight in targets:
                part = slice(*morphs.starts[target : target + 2])
                rows = morphs.vertices[part]
                turn = linear[rows] if linear.ndim == 3 else linear
                moved = weight * np.einsum("...ij,...j->...i", turn, morphs.offsets[part].astype(np.float64))
                self._found.setdefault(name, []).append((rows.astype(np.int64) + first, moved))
                used.add(target)
        return len(morphs) - len(used)

    def morphs(self) -> Morphs | None:
        """Return all expressions, in ARKit's order; None without any."""
        found = {name: self._found[name] for name in ARKIT if name in self._found}
        return Morphs.of(found) if found else None

    def _targets(self, morphs: Morphs, node: int, mesh: int) -> dict[str, list[tuple[int, float]]]:
        """Return ARKit's name -> (target, weight); a target's own name has priority over a VRM's expressions."""
        out: dict[str, list[tuple[int, float]]] = {}
        for target, name in enumerate(morphs.names):
            known = arkit_name(name)
            if known is not None and known not in out:
                out[known] = [(target, 1.0)]
        for name, binds in self._said.items():
            known = arkit_name(name)
            mine = [
                (target, weight)
                for of_node, of_mesh, target, weight in binds
                if (of_node == node or of_mesh == mesh) and 0 <= target < len(morphs)
            ]
            if known is not None and known not in out and mine:
                out[known] = mine
        return out
