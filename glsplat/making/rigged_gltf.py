"""Textured meshes in glTF 2.0: triangles with base colours, rigged by a skin or standing in their nodes' places."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.files import naming, open_regular
from glsplat.formats.gltf.container import Accessor, Container, Primitive, parse
from glsplat.formats.gltf.nodes import Instance, graph_of, instances
from glsplat.formats.gltf.rig import read_skeleton
from glsplat.making.people import decode_texture
from glsplat.meshes import MeshPart, RiggedMesh, standing
from glsplat.skinning.skeleton import Skeleton

__all__ = ["read_gltf_mesh", "read_gltf_person"]

F64 = NDArray[np.float64]


def read_gltf_person(path: str | Path) -> RiggedMesh:
    """The skinned triangles of a .glb or .gltf, with the base colour textures of their materials.

    Takes the skin that moves the most vertices; meshes without it are left out. The zero pose is the file's rest pose.
    Alpha counts where the material says MASK or BLEND. Raises FormatError naming the file: no skinned triangles,
    compressed geometry, a texture that is no JPEG or PNG.
    """
    with naming(path):
        folder = Path(path).parent
        with open_regular(path) as (file, _):
            data = file.read()
        container = parse(data, folder)
        graph = graph_of(container.gltf)
        sized: dict[int, int] = {}
        found: list[Instance] = []
        for i, node in enumerate(container.gltf.nodes):
            if node.mesh is None or node.skin is None:
                continue
            mesh = container.gltf.meshes[node.mesh] if node.mesh < len(container.gltf.meshes) else None
            for p, primitive in enumerate(mesh.primitives if mesh else []):
                where = f"mesh {node.mesh} primitive {p}"
                if primitive.mode == 4 and "JOINTS_0" in primitive.attributes and "POSITION" in primitive.attributes:
                    found.append(Instance(primitive, node, graph.world[i], where))
                    accessor = primitive.attributes["POSITION"]
                    count = container.gltf.accessors[accessor].count if accessor < len(container.gltf.accessors) else 0
                    sized[node.skin] = sized.get(node.skin, 0) + count
        if not found:
            raise FormatError("a person needs triangles with a skin (JOINTS_0 and WEIGHTS_0), found none")
        best = max(sized, key=lambda skin: sized[skin])
        chosen = [instance for instance in found if instance.node.skin == best]
        return _mesh(container, folder, chosen, read_skeleton(container, chosen[0], graph), Path(path).name)


def read_gltf_mesh(path: str | Path) -> RiggedMesh:
    """The skinned triangles of a file as ``read_gltf_person`` gives them, or where it has none all it shows, standing.

    Standing triangles are those of the default scene, placed by their nodes, on one joint at the origin. Raises
    FormatError naming the file.
    """
    with naming(path):
        with open_regular(path) as (file, _):
            data = file.read()
        folder = Path(path).parent
        container = parse(data, folder)
        gltf = container.gltf
        graph = graph_of(gltf)
        shown = [
            i for i in instances(gltf, graph.world) if i.primitive.mode == 4 and "POSITION" in i.primitive.attributes
        ]
        if any(i.node.skin is not None and "JOINTS_0" in i.primitive.attributes for i in shown):
            return read_gltf_person(path)
        if not shown:
            raise FormatError("a mesh needs triangles, this glTF has neither those nor splats (KHR_gaussian_splatting)")
        vertices, parts, first = [], [], 0
        for instance in shown:
            points, faces, corner, texture = _triangles(container, folder, instance)
            with np.errstate(all="ignore"):  # what overflows is refused by RiggedMesh
                vertices.append(points @ instance.matrix[:3, :3].T + instance.matrix[:3, 3])
            parts.append(MeshPart(_name(container, instance), (faces + first).astype(np.int32), corner, texture))
            first += len(points)
        return standing(np.concatenate(vertices), tuple(parts), Path(path).name)


def _triangles(
    container: Container, folder: Path, instance: Instance
) -> tuple[F64, NDArray[np.int64], F64, NDArray[np.uint8]]:
    """Vertices [V, 3], triangles [F, 3], texture coordinates [F, 3, 2] with v up, and the texture of a primitive."""
    primitive, where = instance.primitive, instance.name
    points = container.numbers(primitive.attributes["POSITION"], f"{where} POSITION", ("VEC3",)).astype(np.float64)
    faces = _faces(container, primitive, where, len(points))
    texture, set_of_uv = _texture(container, folder, primitive.material)
    uv = np.zeros((len(points), 2), np.float32)
    if f"TEXCOORD_{set_of_uv}" in primitive.attributes:
        uv = container.numbers(primitive.attributes[f"TEXCOORD_{set_of_uv}"], f"{where} TEXCOORD", ("VEC2",))
    if len(uv) != len(points):
        raise FormatError(f"{where}: TEXCOORD needs {len(points)} elements, as POSITION has")
    corner = uv.astype(np.float64)[faces]
    corner[..., 1] = 1 - corner[..., 1]  # glTF's v axis points down
    return points, faces, corner, texture


def _mesh(container: Container, folder: Path, chosen: list[Instance], skeleton: Skeleton, name: str) -> RiggedMesh:
    vertices: list[F64] = []
    joints: list[NDArray[np.int64]] = []
    weights: list[F64] = []
    parts: list[MeshPart] = []
    first = 0
    for instance in chosen:
        primitive, where = instance.primitive, instance.name
        points, faces, corner, texture = _triangles(container, folder, instance)
        sets = [s for s in (0, 1) if f"JOINTS_{s}" in primitive.attributes and f"WEIGHTS_{s}" in primitive.attributes]
        if 0 not in sets:
            raise FormatError(f"{where}: JOINTS_0 needs WEIGHTS_0 beside it")
        ids = [container.read(primitive.attributes[f"JOINTS_{s}"], f"{where} JOINTS_{s}", ("VEC4",)) for s in sets]
        ws = [container.numbers(primitive.attributes[f"WEIGHTS_{s}"], f"{where} WEIGHTS_{s}", ("VEC4",)) for s in sets]
        if {len(a) for a in (*ids, *ws)} != {len(points)}:
            raise FormatError(f"{where}: JOINTS and WEIGHTS need {len(points)} elements, as POSITION has")
        wide = np.zeros((len(points), 8), np.int64), np.zeros((len(points), 8))
        wide[0][:, : 4 * len(sets)], wide[1][:, : 4 * len(sets)] = np.hstack(ids), np.hstack(ws)
        parts.append(MeshPart(_name(container, instance), (faces + first).astype(np.int32), corner, texture))
        vertices.append(points)
        joints.append(wide[0])
        weights.append(wide[1])
        first += len(points)
    meta = {"source": name} | container.note()
    meta.pop("version", None)
    return RiggedMesh(
        np.concatenate(vertices), skeleton, np.concatenate(joints), np.concatenate(weights), tuple(parts), meta
    )


def _name(container: Container, instance: Instance) -> str:
    """What the material is called, else where the triangles are."""
    index, materials = instance.primitive.material, container.gltf.materials
    entry = materials[index] if index is not None and index < len(materials) else None
    name = entry.get("name") if isinstance(entry, dict) else None
    return name if isinstance(name, str) and name else instance.name


def _faces(container: Container, primitive: Primitive, where: str, count: int) -> NDArray[np.int64]:
    compressed = [name for name in primitive.extensions if "compression" in name]
    if compressed:
        raise FormatError(f"{where}: the geometry is compressed ({compressed[0][:60]}); export it plainly")
    index = np.arange(count)
    if primitive.indices is not None:
        index = container.read(primitive.indices, f"{where} indices", ("SCALAR",))[:, 0].astype(np.int64)
    if len(index) % 3 or (len(index) and index.max() >= count):
        raise FormatError(f"{where}: the indices need whole triangles of {count} vertices")
    return index.reshape(-1, 3)


def _texture(container: Container, folder: Path, material: int | None) -> tuple[NDArray[np.uint8], int]:
    """RGBA of a material's base colour, and which TEXCOORD it uses."""
    try:
        gltf = container.gltf
        entry = gltf.materials[material] if material is not None else {}
        base = entry.get("pbrMetallicRoughness", {})
        factor = np.array(base.get("baseColorFactor", (1, 1, 1, 1)), np.float64)
        factor[:3] = factor[:3] ** (1 / 2.2)  # linear to display, near enough for a flat tint
        opaque = entry.get("alphaMode", "OPAQUE") == "OPAQUE"
        image, uv_set = np.full((4, 4, 4), 255, np.uint8), 0
        if "baseColorTexture" in base:
            uv_set = int(base["baseColorTexture"].get("texCoord", 0))
            source = gltf.textures[base["baseColorTexture"]["index"]]["source"]
            image = decode_texture(_image(container, gltf.images[source], folder), f"image {source}")
    except (AttributeError, KeyError, IndexError, TypeError, ValueError):
        raise FormatError(f"material {material} is malformed or uses an image format that is not supported") from None
    tinted = np.rint(np.clip(image * factor, 0, 255)).astype(np.uint8)
    if opaque:
        tinted[..., 3] = 255
    return tinted, uv_set


def _image(container: Container, image: Mapping[str, Any], folder: Path) -> bytes:
    if "bufferView" in image:
        view = container.gltf.buffer_views[image["bufferView"]]
        # read through an accessor of bytes, so that the bounds are checked in one place
        container.gltf.accessors.append(
            Accessor(component_type=5121, count=view.byte_length, type="SCALAR", buffer_view=image["bufferView"])
        )
        return container.read(len(container.gltf.accessors) - 1, "image", ("SCALAR",)).tobytes()
    uri = str(image["uri"])
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    target = (folder / uri).resolve()
    if not target.is_relative_to(folder.resolve()):
        raise FormatError(f"image {uri[:60]!r} lies outside the file's own folder")
    with open_regular(target) as (file, _):
        return file.read()
