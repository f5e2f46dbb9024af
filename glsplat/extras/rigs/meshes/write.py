"""Write textured, skinned meshes as glTF 2.0 for other programs; reader.py reads them back.

Materials are unlit (KHR_materials_unlit), as the colours contain the picture's light. A texture with holes (alpha
below one half) has the material MASK. A large texture without holes is a JPEG of quality 95 without chroma
subsampling: 2048 x 2048 texels of a photograph take 0.7 MB, and 2.5 MB as PNG. All others are PNG.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.morphs import add_sparse, index_code
from glsplat.formats.gltf.output import INDICES, UNLIT, Output, unlit_material
from glsplat.formats.gltf.rig import write_influences, write_skeleton
from glsplat.formats.gltf.schema import Mesh, Node, Primitive, Scene
from glsplat.io.files import Source
from glsplat.meshes import MeshPart, Morphs, RiggedMesh
from glsplat.skinning.skin import INFLUENCES, Skin

_VERSION = 1  # of asset.extras.glsplat
_SMALL = 640 * 640  # texels up to which a texture is a PNG
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
_LINEAR, _MIPMAPS = 9729, 9987


def save_gltf_mesh(mesh: RiggedMesh, target: Source, *, embedded: bool | None = None) -> None:
    """Write a .glb, or if ``target`` ends in .gltf one JSON file with its buffer ``embedded``.

    Each part becomes a primitive and a material of its name, expressions become morph targets, joints become nodes of
    their names, and ``meta`` becomes ``asset.extras``. Positions, weights and texture coordinates are float32; a vertex
    has its eight strongest influences. Raises FormatError if ``target`` cannot be written or the notes are not JSON.
    """
    out = Output()
    gltf = out.gltf
    used = int((mesh.weights > 0).sum(axis=1).max(initial=1))
    influences = next((k for k in INFLUENCES if k >= used), INFLUENCES[-1])
    skin = Skin.create(mesh.joints, mesh.weights, len(mesh.skeleton), influences)
    sources: dict[int, int] = {}  # textures that parts share are written once
    primitives = []
    for part in mesh.parts:
        if not len(part.faces):
            continue
        if id(part.texture) not in sources:
            sources[id(part.texture)] = _add_texture(out, part)
        gltf.materials.append(_material(part, sources[id(part.texture)]))
        primitives.append(_primitive(out, mesh, skin, part, len(gltf.materials) - 1))
    gltf.samplers = [{"magFilter": _LINEAR, "minFilter": _MIPMAPS}]
    names = None if mesh.morphs is None else {"targetNames": list(mesh.morphs.names)}
    gltf.meshes = [Mesh(primitives=primitives, extras=names)]
    gltf.nodes = [Node(name="mesh", mesh=0)]
    gltf.scene, gltf.scenes = 0, [Scene(nodes=[0])]
    write_skeleton(out, mesh.skeleton)
    gltf.extensions_used = [UNLIT]
    out.note({"version": _VERSION} | dict(mesh.meta))
    out.write(target, embedded=embedded)


def _primitive(out: Output, mesh: RiggedMesh, skin: Skin, part: MeshPart, material: int) -> Primitive:
    """Write a part's triangles, with a vertex for each pair of a position and a texture coordinate."""
    uv = np.stack([part.uv[..., 0], 1 - part.uv[..., 1]], axis=-1).astype(np.float32).reshape(-1, 2)  # v points down
    corners = np.empty(len(uv), [("vertex", np.int32), ("uv", np.uint64)])
    corners["vertex"], corners["uv"] = part.faces.ravel(), uv.view(np.uint64)[:, 0]
    _, first, index = np.unique(corners, return_index=True, return_inverse=True)
    vertex = part.faces.ravel()[first]
    attributes = {
        "POSITION": out.add(mesh.vertices[vertex].astype(np.float32), "VEC3", bounds=True),
        "TEXCOORD_0": out.add(uv[first], "VEC2"),
    }
    write_influences(out, skin.take(vertex), len(mesh.skeleton), attributes)
    wide = index.reshape(-1, 1).astype(np.uint16 if len(first) < 0xFFFF else np.uint32)
    indices = out.add(wide, "SCALAR", target=INDICES)
    targets = [] if mesh.morphs is None else _targets(out, mesh.morphs, len(mesh.vertices), vertex)
    return Primitive(attributes=attributes, indices=indices, material=material, targets=targets)


def _targets(out: Output, morphs: Morphs, count: int, vertex: NDArray[np.int32]) -> list[dict[str, int]]:
    """Write morph targets of a part, sparse; its vertices are ``vertex`` of the mesh's ``count``."""
    targets = []
    for target in range(len(morphs)):
        part = slice(*morphs.starts[target : target + 2])
        offsets = np.zeros((count, 3), np.float32)
        np.add.at(offsets, morphs.vertices[part], morphs.offsets[part])
        moved = offsets[vertex]
        rows = np.flatnonzero(moved.any(axis=1))
        indices = out.add_bytes(rows.astype(index_code(len(vertex))).tobytes())
        targets.append({"POSITION": add_sparse(out, len(vertex), indices, moved[rows], "VEC3")})
    return targets


def _material(part: MeshPart, texture: int) -> dict[str, Any]:
    material = unlit_material(part.name) | {"doubleSided": True}
    material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": texture}
    if not _whole(part):
        material |= {"alphaMode": "MASK", "alphaCutoff": 0.5}
    return material


def _add_texture(out: Output, part: MeshPart) -> int:
    """Add a texture and return its index."""
    bgra = np.ascontiguousarray(part.texture[..., [2, 1, 0, 3]])
    picture = np.ascontiguousarray(bgra[..., :3]) if _whole(part) else bgra
    large = _whole(part) and picture.shape[0] * picture.shape[1] > _SMALL
    suffix, kind, options = (".jpg", "image/jpeg", _JPEG) if large else (".png", "image/png", [])
    ok, data = cv2.imencode(suffix, picture, options)
    if not ok:
        raise FormatError(f'the texture of part "{part.name}" cannot be encoded')
    image: Mapping[str, Any] = {"bufferView": out.add_bytes(data.tobytes()), "mimeType": kind}
    out.gltf.images.append(image)
    out.gltf.textures.append({"sampler": 0, "source": len(out.gltf.images) - 1})
    return len(out.gltf.textures) - 1


def _whole(part: MeshPart) -> bool:
    return bool((part.texture[..., 3] == 255).all())
