"""The JSON of glTF 2.0 as typed structs, which msgspec fills: as far as splats and meshes need it."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec

Index = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Vec3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Vec4 = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]
Mat4 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]


class _Object(msgspec.Struct, rename="camel", omit_defaults=True, kw_only=True):
    extensions: dict[str, Any] = {}


class Asset(_Object):
    """asset: the version is required to be 2.x."""

    version: str = ""
    generator: str | None = None
    extras: Any = None


class Buffer(_Object):
    """buffers[]: without a URI it is the binary chunk of the GLB."""

    byte_length: Index
    uri: str | None = None


class BufferView(_Object):
    """bufferViews[]."""

    buffer: Index
    byte_length: Index
    byte_offset: Index = 0
    byte_stride: Index | None = None
    target: int | None = None


class Accessor(_Object):
    """accessors[]."""

    component_type: int
    count: Index
    type: str
    buffer_view: Index | None = None
    byte_offset: Index = 0
    normalized: bool = False
    sparse: Any = None
    min: list[float] | None = None
    max: list[float] | None = None


class _Indices(msgspec.Struct, rename="camel", kw_only=True):
    """accessors[].sparse.indices."""

    buffer_view: Index
    component_type: int
    byte_offset: Index = 0


class _Values(msgspec.Struct, rename="camel", kw_only=True):
    """accessors[].sparse.values."""

    buffer_view: Index
    byte_offset: Index = 0


class Sparse(msgspec.Struct):
    """accessors[].sparse."""

    count: Index
    indices: _Indices
    values: _Values


class Packed(msgspec.Struct, rename="camel", kw_only=True):
    """bufferViews[].extensions.EXT_meshopt_compression."""

    buffer: Index
    byte_length: Index
    byte_stride: Index
    count: Index
    mode: str
    filter: str = "NONE"
    byte_offset: Index = 0


class Primitive(_Object):
    """meshes[].primitives[]; mode 4 (triangles) is the default of the specification."""

    attributes: dict[str, Index] = {}
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    targets: list[dict[str, Index]] = []
    extras: Any = None


class Mesh(_Object):
    """meshes[]."""

    primitives: list[Primitive] = []
    weights: list[float] = []
    name: str | None = None
    extras: Any = None


class Node(_Object):
    """nodes[]: a matrix (column-major) or translation, rotation (xyzw) and scale."""

    name: str | None = None
    mesh: Index | None = None
    skin: Index | None = None
    children: list[Index] = []
    matrix: Mat4 | None = None
    translation: Vec3 | None = None
    rotation: Vec4 | None = None
    scale: Vec3 | None = None
    weights: list[float] = []
    extras: Any = None


class Skin(_Object):
    """skins[]."""

    joints: list[Index] = []
    inverse_bind_matrices: Index | None = None
    skeleton: Index | None = None
    name: str | None = None


class Scene(_Object):
    """scenes[]."""

    nodes: list[Index] = []


class Gltf(_Object):
    """The root object, as far as splats and meshes need it; materials and textures stay untyped."""

    asset: Asset = msgspec.field(default_factory=Asset)
    extensions_used: list[str] = []
    extensions_required: list[str] = []
    scene: Index | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    skins: list[Skin] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    materials: list[Any] = []
    textures: list[Any] = []
    images: list[Any] = []
    samplers: list[Any] = []
    animations: list[Any] = []
