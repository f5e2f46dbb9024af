"""The glTF 2.0 container: GLB chunks, buffers and accessors.

The JSON is decoded into the structs of schema.py by msgspec, which checks every type and names the place of a mistake
("$.accessors[0].count").
"""

from __future__ import annotations

import base64
import binascii
import io
import logging
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, TypeVar
from urllib.parse import unquote

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.schema import Accessor, BufferView, Gltf, Packed, Sparse
from glsplat.io.files import left_out, open_regular, sampled
from glsplat.optional import missing, plugin

log: logging.Logger = logging.getLogger(__name__)

T = TypeVar("T")
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FULL_SCALE = {"i1": 127.0, "u1": 255.0, "<i2": 32767.0, "<u2": 65535.0}
_MESHOPT = "EXT_meshopt_compression", "KHR_meshopt_compression"
_MAX_EMPTY = 1 << 22  # elements of a sparse accessor without a bufferView, which nothing else bounds
_SAMPLED_BYTES = 1 << 24  # of JSON, above which it is checked for holes first
MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942  # glTF, JSON, BIN


@dataclass(frozen=True, slots=True)
class Blob:
    """Bytes of a file, read on demand: an accessor may need little of a large buffer."""

    source: BinaryIO | Path
    start: int
    length: int

    @classmethod
    def of(cls, data: bytes) -> Blob:
        """Wrap bytes that are in memory."""
        return cls(io.BytesIO(data), 0, len(data))

    def __len__(self) -> int:
        return self.length

    def part(self, start: int, count: int) -> bytes:
        """Read ``count`` bytes from ``start``, which the caller has checked to be there."""
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
        self._taken: dict[int, int] = {}  # buffer -> bytes of it that were unpacked
        self._unpacked: dict[int, Blob] = {}  # bufferView -> its bytes
        self._mended: dict[tuple[str, int], int] = {}  # kind and accessor of ``mended`` -> count

    def read(self, index: int, what: str, types: tuple[str, ...]) -> NDArray[np.generic]:
        """Read the elements of an accessor [count, width], raw component type.

        ``what`` names the accessor in messages. Raises FormatError when it leaves its buffer or has another type
        than one of ``types``; no memory is allocated for what the buffer does not hold, and no more of it is read.
        """
        accessor = item(self.gltf.accessors, index, f"accessor of {what}")
        if accessor.sparse is None:
            return self._elements(accessor, what, types)
        rows, values = self.sparse(index, what, types)
        if accessor.buffer_view is None:
            if accessor.count > _MAX_EMPTY:
                raise FormatError(f"{what} needs at most {_MAX_EMPTY} elements over nothing, not {accessor.count}")
            out = np.zeros((accessor.count, values.shape[1]), values.dtype)
        else:
            out = self._elements(accessor, what, types).copy()
        out[rows] = values
        return out

    def sparse(
        self, index: int, what: str, types: tuple[str, ...]
    ) -> tuple[NDArray[np.unsignedinteger[Any]], NDArray[Any]]:
        """Read the indices [K] and the values [K, width] of a sparse accessor."""
        accessor = item(self.gltf.accessors, index, f"accessor of {what}")
        try:
            sparse = msgspec.convert(accessor.sparse, Sparse)
        except msgspec.ValidationError as error:
            raise FormatError(f"{what} is a broken sparse accessor: {str(error)[:120]}") from None
        part = Accessor(
            component_type=sparse.indices.component_type,
            count=sparse.count,
            type="SCALAR",
            buffer_view=sparse.indices.buffer_view,
            byte_offset=sparse.indices.byte_offset,
        )
        rows = self._elements(part, f"{what} indices", ("SCALAR",))[:, 0]
        if rows.dtype.kind != "u" or sparse.count > accessor.count or (len(rows) and int(rows.max()) >= accessor.count):
            raise FormatError(f"{what} needs indices of its {accessor.count} elements as unsigned integers")
        part = msgspec.structs.replace(
            accessor,
            count=sparse.count,
            buffer_view=sparse.values.buffer_view,
            byte_offset=sparse.values.byte_offset,
            sparse=None,
        )
        return rows, self._elements(part, f"{what} values", types)

    def _elements(self, accessor: Accessor, what: str, types: tuple[str, ...]) -> NDArray[Any]:
        """Read the elements [count, width] of an accessor from its bufferView."""
        code = _COMPONENTS.get(accessor.component_type)
        if accessor.type not in types or code is None:
            raise FormatError(
                f"{what} needs type {' or '.join(types)}, not {accessor.type[:16]!r} of {accessor.component_type}"
            )
        width = _WIDTHS[accessor.type]
        dtype = np.dtype(code)
        if accessor.count == 0:
            return np.empty((0, width), dtype)
        if accessor.buffer_view is None:
            raise FormatError(f"{what} has no bufferView (compressed by an extension?); store it uncompressed")
        view = item(self.gltf.buffer_views, accessor.buffer_view, f"bufferView of {what}")
        data, start = self._bytes(accessor.buffer_view, view, what)
        size = dtype.itemsize * width
        stride = size if view.byte_stride is None else view.byte_stride
        if stride < size:
            raise FormatError(f"{what} has a byteStride of {stride}, its elements take {size} bytes")
        end = accessor.byte_offset + stride * (accessor.count - 1) + size
        if end > view.byte_length or start + end > len(data):
            raise FormatError(
                f"truncated: {what} needs {end} bytes for {accessor.count} elements, its bufferView has "
                f"{min(view.byte_length, max(len(data) - start, 0))}"
            )
        part = data.part(start + accessor.byte_offset, stride * (accessor.count - 1) + size)
        return np.ndarray((accessor.count, width), dtype, part, 0, (stride, dtype.itemsize))

    def _bytes(self, index: int, view: BufferView, what: str) -> tuple[Blob, int]:
        """Return the bytes that a bufferView is a part of, and where it starts; unpacked where it is packed."""
        packed = next((view.extensions[name] for name in _MESHOPT if name in view.extensions), None)
        if packed is None:
            return self._buffer(view.buffer), view.byte_offset
        if index not in self._unpacked:
            meshopt = plugin("formats.meshopt")
            if meshopt is None:
                raise FormatError(missing("formats", f"{what}, which is packed by meshopt,"))
            try:
                how = msgspec.convert(packed, Packed)
            except msgspec.ValidationError as error:
                raise FormatError(f"{what} is packed in a broken way: {str(error)[:120]}") from None
            if how.count * how.byte_stride != view.byte_length:
                raise FormatError(
                    f"{what}: a bufferView of {view.byte_length} bytes does not hold what is packed in it"
                )
            data = self._take(how.buffer, how.byte_offset, how.byte_length, what)
            self._unpacked[index] = Blob.of(
                meshopt.unpacked(data, how.mode, how.count, how.byte_stride, how.filter, what)
            )
        return self._unpacked[index], 0

    def view(self, index: int, what: str) -> bytes:
        """Read the bytes of a bufferView, for an extension that decodes them.

        Raises FormatError when it leaves its buffer, and when all views read so take more bytes than the buffer has:
        bytes that unpack to a thousand times as many are read once.
        """
        view = item(self.gltf.buffer_views, index, f"bufferView of {what}")
        return self._take(view.buffer, view.byte_offset, view.byte_length, what)

    def _take(self, buffer: int, start: int, length: int, what: str) -> bytes:
        data = self._buffer(buffer)
        if start + length > len(data):
            raise FormatError(f"truncated: {what} needs {length} bytes, its buffer ends before")
        taken = self._taken[buffer] = self._taken.get(buffer, 0) + length
        if taken > len(data):
            raise FormatError(f"{what}: packed bufferViews overlap; give each its own bytes")
        return data.part(start, length)

    def numbers(self, index: int, what: str, types: tuple[str, ...]) -> NDArray[np.float32]:
        """Read the elements of an accessor [count, width] as float32, normalised integers decoded (glTF 2.0, 3.11)."""
        return self.decoded(index, self.read(index, what, types))

    def decoded(self, index: int, raw: NDArray[Any]) -> NDArray[np.float32]:
        """Decode the raw elements of an accessor to float32, as ``numbers`` does."""
        with np.errstate(invalid="ignore"):
            values = np.ascontiguousarray(raw, np.float32)
        code = _COMPONENTS[self.gltf.accessors[index].component_type]
        if self.gltf.accessors[index].normalized and code in _FULL_SCALE:
            values = np.maximum(values / np.float32(_FULL_SCALE[code]), np.float32(-1))
        return values

    def finite(
        self, index: int, what: str, types: tuple[str, ...], said: str, instead: float, *, whole: bool = True
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Read as ``numbers`` does, with NaN and infinity replaced; return also which numbers were replaced.

        With ``whole``, one number that is not finite replaces all of its element, and elements are counted. ``warn``
        reports the count as ``said``.
        """
        values = self.numbers(index, what, types)
        bad = ~np.isfinite(values)
        if bad.any():
            count = int((bad.any(axis=1) if whole else bad).sum())
            bad |= whole & bad.any(axis=1, keepdims=True)
            values = np.where(bad, np.float32(instead), values)
            self.mended(index, said, count)
        return values, bad

    def mended(self, index: int, said: str, count: int) -> None:
        """Record ``count`` repaired elements of an accessor for ``warn``; read again, they count once."""
        self._mended[said, index] = count

    def warn(self) -> None:
        """Log one warning with the counts of all repairs; strict reading raises a FormatError (``left_out``)."""
        counts: dict[str, int] = {}
        for (said, _), count in self._mended.items():
            counts[said] = counts.get(said, 0) + count
        if counts:
            left_out(log, "holds NaN or infinity: " + ", ".join(f"{counts[said]} {said}" for said in sorted(counts)))

    def note(self) -> dict[str, Any]:
        """Return the metadata of ``Output.note``; empty in the files of others."""
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
                self._uris[buffer.uri] = self._fetch(buffer.uri, "buffer")
            data = self._uris[buffer.uri]
        if len(data) < buffer.byte_length:
            raise FormatError(f"truncated: buffer {index} declares {buffer.byte_length} bytes, {len(data)} are there")
        return replace(data, length=buffer.byte_length)

    def fetched(self, uri: str, what: str) -> bytes:
        """Read the data or file of a URI; a file has to be in this one's folder. Raises FormatError for others."""
        blob = self._fetch(uri, what)
        return blob.part(0, len(blob))

    def _fetch(self, uri: str, what: str) -> Blob:
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            try:
                if not comma or not head.endswith(";base64"):
                    raise ValueError("no ;base64")
                return Blob.of(base64.b64decode(body, validate=True))
            except (ValueError, binascii.Error) as error:
                raise FormatError(f"the data URI of a {what} is not base64 ({str(error)[:60]})") from None
        name = unquote(uri)
        if self._folder is None:
            raise FormatError(
                f"the {what} {name[:60]!r} is a file of its own, and an open file has no folder; give its path"
            )
        folder = self._folder.resolve()
        try:
            target = (folder / name).resolve()
        except (OSError, ValueError, RuntimeError):
            raise FormatError(f"the {what} {name[:60]!r} is not the path of a file") from None
        # also catches absolute paths and symbolic links that lead out
        if "\\" in name or ":" in name or not target.is_relative_to(folder):
            raise FormatError(f"the {what} {name[:60]!r} lies outside the file's own folder; put it beside the file")
        with open_regular(target) as (_, size):
            return Blob(target, 0, size)


def item(items: list[T], index: int, what: str) -> T:
    """Return ``items[index]``; FormatError when the file refers to something it does not have."""
    if index >= len(items):
        raise FormatError(f"the file refers to {what} {index}, but has {len(items)}")
    return items[index]


def parse(data: bytes, folder: Path) -> Container:
    """Parse a GLB, or the JSON of a .gltf whose buffers lie in ``folder``. FormatError does not name the file."""
    return read_container(io.BytesIO(data), len(data), folder)


def read_container(file: BinaryIO, size: int, folder: Path | None) -> Container:
    """Parse an open file of ``size`` bytes; it has to stay open while the container is read from."""
    text, blob = chunks(file, size)
    # a hole in a file is not read: JSON has no zero bytes
    if text.length > _SAMPLED_BYTES and b"\0" in sampled(file, text.start, text.length):
        raise FormatError("the glTF JSON is broken: it has zero bytes (a hole in the file?)")
    try:
        gltf = msgspec.json.decode(text.part(0, text.length), type=Gltf)
    except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
        raise FormatError(f"the glTF JSON is broken: {str(error)[:160]}") from None
    if not gltf.asset.version.startswith("2."):
        raise FormatError(f"needs glTF 2.0, found asset.version {gltf.asset.version[:16]!r}")
    return Container(gltf, blob, folder)


def glb_length(head: bytes) -> int:
    """Return the length in a GLB's header; bytes behind it are ignored. ``head`` are its first 12 or more."""
    return int(struct.unpack_from("<I", head, 8)[0])


def chunks(file: BinaryIO, have: int) -> tuple[Blob, Blob | None]:
    """Return the JSON of an open file of ``have`` bytes, and a GLB's binary chunk (4.4). Raises FormatError."""
    file.seek(0)
    head = file.read(20)
    if head[:4] != b"glTF":
        return Blob(file, 0, have), None
    if have < 20:
        raise FormatError(f"truncated: a GLB has a header of 20 bytes, this file has {have}")
    version, length = struct.unpack_from("<I", head, 4)[0], glb_length(head)
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
