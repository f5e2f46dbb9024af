"""The glTF 2.0 container: a typed description of the JSON, GLB chunks, buffers and accessors.

The JSON is decoded into these structs by msgspec, which checks every type and names the place of a mistake
("$.accessors[0].count"). Measured on an avatar with 56 nodes and 60 accessors: 0.2 ms, against 38 ms (and 50 ms of
import) for pygltflib, which checks nothing and drops empty metadata; the tests use that as a second reader.
"""

from __future__ import annotations

import base64
import binascii
import io
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, BinaryIO, TypeVar
from urllib.parse import unquote

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.files import open_regular, sampled

__all__ = [
    "Accessor",
    "Asset",
    "Blob",
    "Buffer",
    "BufferView",
    "Container",
    "Gltf",
    "Mesh",
    "Node",
    "Primitive",
    "Scene",
]
__all__ += ["Index", "Skin", "item", "parse", "read_container"]

T = TypeVar("T")
Index = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
Vec3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Vec4 = Annotated[list[float], msgspec.Meta(min_length=4, max_length=4)]
Mat4 = Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FULL_SCALE = {"i1": 127.0, "u1": 255.0, "<i2": 32767.0, "<u2": 65535.0}
_SAMPLED = 1 << 24  # bytes of JSON above which it is looked at for holes first
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942  # glTF, JSON, BIN


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


class Primitive(_Object):
    """meshes[].primitives[]; mode 4 (triangles) is the default of the specification."""

    attributes: dict[str, Index] = {}
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    targets: list[dict[str, Index]] = []


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
    """The root object, as far as splats and meshes need it; what colours or moves them is left as it is written."""

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


@dataclass(frozen=True, slots=True)
class Blob:
    """Bytes of a file, read where they are needed: an accessor may want little of a large buffer."""

    source: BinaryIO | Path
    start: int
    length: int

    @classmethod
    def of(cls, data: bytes) -> Blob:
        """Bytes that are in memory."""
        return cls(io.BytesIO(data), 0, len(data))

    def __len__(self) -> int:
        return self.length

    def part(self, start: int, count: int) -> bytes:
        """``count`` bytes from ``start``, which the caller knows to be there."""
        if isinstance(self.source, Path):
            with open_regular(self.source) as (file, _):
                return replace(self, source=file).part(start, count)
        self.source.seek(self.start + start)
        data = self.source.read(count)
        if len(data) != count:
            raise FormatError("the file became shorter while it was read")
        return data


class Container:
    """A parsed file: the JSON and, on demand, its buffers. Nothing outside the file's own folder is opened."""

    def __init__(self, gltf: Gltf, blob: Blob | None, folder: Path | None) -> None:
        self.gltf = gltf
        self._blob = blob
        self._folder = folder
        self._uris: dict[str, Blob] = {}
        self._taken: dict[int, int] = {}  # buffer -> bytes of it that ``view`` gave

    def read(self, index: int, what: str, types: tuple[str, ...]) -> NDArray[np.generic]:
        """The elements of an accessor [count, width], raw component type.

        ``what`` names the accessor in messages. Raises FormatError when it leaves its buffer or has another type
        than one of ``types``; no memory is allocated for what the buffer does not hold, and no more of it is read.
        """
        accessor = item(self.gltf.accessors, index, f"accessor of {what}")
        code = _COMPONENTS.get(accessor.component_type)
        if accessor.type not in types or code is None:
            raise FormatError(
                f"{what} needs type {' or '.join(types)}, not {accessor.type[:16]!r} of {accessor.component_type}"
            )
        width = _WIDTHS[accessor.type]
        dtype = np.dtype(code)
        if accessor.sparse is not None:
            raise FormatError(f"{what} is a sparse accessor, which is not supported; store it densely")
        if accessor.count == 0:
            return np.empty((0, width), dtype)
        if accessor.buffer_view is None:
            raise FormatError(f"{what} has no bufferView (compressed by an extension?); store it uncompressed")
        view = item(self.gltf.buffer_views, accessor.buffer_view, f"bufferView of {what}")
        data = self._buffer(view.buffer)
        size = dtype.itemsize * width
        stride = size if view.byte_stride is None else view.byte_stride
        if stride < size:
            raise FormatError(f"{what} has a byteStride of {stride}, its elements take {size} bytes")
        end = accessor.byte_offset + stride * (accessor.count - 1) + size
        if end > view.byte_length or view.byte_offset + end > len(data):
            raise FormatError(
                f"truncated: {what} needs {end} bytes for {accessor.count} elements, its bufferView has "
                f"{min(view.byte_length, max(len(data) - view.byte_offset, 0))}"
            )
        offset = view.byte_offset + accessor.byte_offset
        part = data.part(offset, stride * (accessor.count - 1) + size)
        return np.ndarray((accessor.count, width), dtype, part, 0, (stride, dtype.itemsize))

    def view(self, index: int, what: str) -> bytes:
        """The bytes of a bufferView, for an extension that knows what they are.

        Raises FormatError when it leaves its buffer, and when those asked for take more bytes than there are: bytes
        that unpack to a thousand times as many are not to be had again and again.
        """
        view = item(self.gltf.buffer_views, index, f"bufferView of {what}")
        data = self._buffer(view.buffer)
        if view.byte_offset + view.byte_length > len(data):
            raise FormatError(f"truncated: {what} needs {view.byte_length} bytes, its buffer ends before")
        taken = self._taken[view.buffer] = self._taken.get(view.buffer, 0) + view.byte_length
        if taken > len(data):
            raise FormatError(f"{what}: the bufferViews of packed splats overlap; give each its own bytes")
        return data.part(view.byte_offset, view.byte_length)

    def numbers(self, index: int, what: str, types: tuple[str, ...]) -> NDArray[np.float32]:
        """The elements of an accessor [count, width] as float32, normalised integers decoded (glTF 2.0, 3.11)."""
        raw = self.read(index, what, types)
        with np.errstate(invalid="ignore"):
            values = np.ascontiguousarray(raw, np.float32)
        code = _COMPONENTS[self.gltf.accessors[index].component_type]
        if self.gltf.accessors[index].normalized and code in _FULL_SCALE:
            values = np.maximum(values / np.float32(_FULL_SCALE[code]), np.float32(-1))
        return values

    def note(self) -> dict[str, Any]:
        """What ``Output.note`` wrote; empty in the files of others."""
        extras = self.gltf.asset.extras
        note = extras.get("glsplat") if isinstance(extras, dict) else None
        return dict(note) if isinstance(note, dict) else {}

    def _buffer(self, index: int) -> Blob:
        buffer = item(self.gltf.buffers, index, "buffer")
        if buffer.uri is None:
            if index or self._blob is None:
                raise FormatError(f"buffer {index} has no URI, and the file no binary chunk for it")
            data = self._blob
        else:
            if buffer.uri not in self._uris:
                self._uris[buffer.uri] = self._fetch(buffer.uri)
            data = self._uris[buffer.uri]
        if len(data) < buffer.byte_length:
            raise FormatError(f"truncated: buffer {index} declares {buffer.byte_length} bytes, {len(data)} are there")
        return replace(data, length=buffer.byte_length)

    def _fetch(self, uri: str) -> Blob:
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            try:
                if not comma or not head.endswith(";base64"):
                    raise ValueError("no ;base64")
                return Blob.of(base64.b64decode(body, validate=True))
            except (ValueError, binascii.Error) as error:
                raise FormatError(f"a data URI of a buffer is not base64 ({str(error)[:60]})") from None
        name = unquote(uri)
        if self._folder is None:
            raise FormatError(
                f"the buffer {name[:60]!r} is a file of its own, and an open file has no folder; give its path"
            )
        folder = self._folder.resolve()
        try:
            target = (folder / name).resolve()
        except (OSError, ValueError, RuntimeError):
            raise FormatError(f"the buffer {name[:60]!r} is no path of a file") from None
        # also catches absolute paths and symbolic links that lead out
        if "\\" in name or ":" in name or not target.is_relative_to(folder):
            raise FormatError(f"the buffer {name[:60]!r} lies outside the file's own folder; put it beside the file")
        with open_regular(target) as (_, size):
            return Blob(target, 0, size)


def item(items: list[T], index: int, what: str) -> T:
    """``items[index]``, or a FormatError when the file refers to something it does not have."""
    if index >= len(items):
        raise FormatError(f"the file refers to {what} {index}, but has {len(items)}")
    return items[index]


def parse(data: bytes, folder: Path) -> Container:
    """A GLB, or the JSON of a .gltf whose buffers lie in ``folder``. Raises FormatError without naming the file."""
    return read_container(io.BytesIO(data), len(data), folder)


def read_container(file: BinaryIO, size: int, folder: Path | None) -> Container:
    """The same of an open file of ``size`` bytes; it has to stay open while the container is read from."""
    text, blob = Blob(file, 0, size), None
    file.seek(0)
    head = file.read(20)
    if head[:4] == b"glTF":
        text, blob = _chunks(file, size, head)
    # a hole in a file is not read: JSON has no zero bytes
    if text.length > _SAMPLED and b"\0" in sampled(file, text.start, text.length):
        raise FormatError("the glTF JSON is broken: it has zero bytes (a hole in the file?)")
    try:
        gltf = msgspec.json.decode(text.part(0, text.length), type=Gltf)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise FormatError(f"the glTF JSON is broken: {str(error)[:160]}") from None
    if not gltf.asset.version.startswith("2."):
        raise FormatError(f"needs glTF 2.0, found asset.version {gltf.asset.version[:16]!r}")
    return Container(gltf, blob, folder)


def _chunks(file: BinaryIO, have: int, head: bytes) -> tuple[Blob, Blob | None]:
    if have < 20:
        raise FormatError(f"truncated: a GLB has a header of 20 bytes, this file has {have}")
    _, version, length = struct.unpack_from("<III", head)
    if version != 2:
        raise FormatError(f"needs GLB version 2, found {version}")
    if length > have:
        raise FormatError(f"truncated: the GLB header declares {length} bytes, the file has {have}")
    found: list[Blob] = []
    at = 12
    for kind, name in ((JSON_CHUNK, "JSON"), (BINARY_CHUNK, "BIN")):
        if at + 8 > length:
            break
        size, tag = struct.unpack("<II", Blob(file, at, 8).part(0, 8))
        if at + 8 + size > length:
            raise FormatError(f"truncated: the {name} chunk declares {size} bytes, {length - at - 8} are left")
        if tag != kind:
            break
        found.append(Blob(file, at + 8, size))
        at += 8 + size
    if not found:
        raise FormatError("the first chunk of a GLB needs to be JSON")
    return found[0], found[1] if len(found) > 1 else None
