"""Read the consent record in a .glb, check it against the content, and write it without any other change."""

from __future__ import annotations

import hashlib
import io
import json
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Unpack

from glsplat.errors import FormatError
from glsplat.extras.consent.document import Consent, Terms, read_record, signed_record
from glsplat.extras.consent.keys import PrivateKey
from glsplat.extras.consent.record import file_digest, record_of, without_record
from glsplat.formats.gltf.container import JSON_CHUNK, MAGIC, Container, chunks, glb_length, item, read_container
from glsplat.formats.gltf.levels import LOD, finest_of
from glsplat.formats.gltf.nodes import Instance, graph_of, instances
from glsplat.formats.gltf.output import CONSENT
from glsplat.formats.gltf.primitive import EXTENSION, packed_view
from glsplat.io.files import naming, open_regular, replace_file

_TYPES = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4")


def level_digest(container: Container) -> tuple[str, bool]:
    """Return the SHA-256 (hex) of the attribute arrays of level 0, and whether the file shows anything else.

    The hash covers the primitives with splats in the order of the default scene, their attributes in the file's order,
    elements packed without padding; of SPZ its packed bytes; of an accessor without data, which means zeros (glTF 2.0,
    5.1.1), "zeros TYPE CODE COUNT". A file without splats is hashed by its triangles. Raises FormatError for missing
    arrays.
    """
    gltf = container.gltf
    graph = graph_of(gltf)
    every = list(instances(gltf, graph.world))
    splats = [one for one in every if EXTENSION in one.primitive.extensions]
    found = finest_of(splats) if splats else every
    if not found:
        raise FormatError("shows nothing that could be hashed")
    digest, seen = hashlib.sha256(), set()
    for one in found:
        if id(one.primitive) not in seen:  # two nodes may share a mesh
            seen.add(id(one.primitive))
            for part in _arrays(container, one):
                digest.update(part)
    only_finest = len(found) == len(every) and bool(splats) and not any(LOD in one.node.extensions for one in found)
    return digest.hexdigest(), not only_finest


def _arrays(container: Container, one: Instance) -> list[bytes]:
    view = packed_view(one.primitive.extensions[EXTENSION], one.name) if EXTENSION in one.primitive.extensions else None
    if view is not None:
        return [container.view(view, one.name)]
    return [_array(container, index, f"{one.name} {key}") for key, index in one.primitive.attributes.items()]


def _array(container: Container, index: int, what: str) -> bytes:
    accessor = item(container.gltf.accessors, index, f"accessor of {what}")
    if accessor.buffer_view is None and accessor.sparse is None:
        return f"zeros {accessor.type} {accessor.component_type} {accessor.count}".encode()
    return container.read(index, what, _TYPES).tobytes()


NONE = "no consent on file"
"""Shown, also in pictures, if a consent is missing."""

_ONLY_GLB = "a consent is kept in .glb files alone; convert it first (glsplat convert IN OUT.glb)"
_DAMAGED = "its consent is for something else: the file was changed after it was signed"


@dataclass(frozen=True, slots=True)
class OnFile:
    """The consent of a file, or the reason why it has none."""

    consent: Consent | None = None
    fault: str = ""  # why no consent is valid; "" with a valid one, or without a real person
    nobody: bool = False  # a file of glsplat that shows a synthetic person, who need not agree

    @property
    def hands_out(self) -> bool:
        """Whether viewers may receive the splats themselves."""
        return self.nobody or (self.consent is not None and self.consent.hand_out)


def on_file(path: str | Path) -> OnFile:
    """Return the consent in an avatar's file; an invalid record is its ``fault``. Raises FormatError."""
    with naming(path), open_regular(path) as (file, _):
        data = file.read()
    return OnFile(nobody=True) if _is_own_file(data) else on_file_data(data)


def on_file_data(data: bytes) -> OnFile:
    """Return the consent in the bytes of a file; files of glsplat are not recognised."""
    if not data.startswith(b"glTF"):
        return OnFile(fault=f"{NONE} ({_ONLY_GLB})")
    try:
        glb = _Glb(data)
        record = record_of(glb.document)
        if not isinstance(record, dict):
            return OnFile(fault=NONE)
        consent = read_record(record)
        splats, more = level_digest(glb.container())
        if splats != consent.splats_sha256:
            return OnFile(fault=_DAMAGED)
        if consent.file_sha256 is None:
            unsigned = "levels of detail, textures or things are in the file that its consent does not cover"
            return OnFile(fault=unsigned) if more else OnFile(consent)
        return OnFile(consent) if glb.digest() == consent.file_sha256 else OnFile(fault=_DAMAGED)
    except FormatError as error:
        return OnFile(fault=str(error))


def sign_data(data: bytes, key: PrivateKey, **terms: Unpack[Terms]) -> bytes:
    """Return a .glb with a new record. The binary chunk keeps its bytes; the JSON is rewritten.

    Raises FormatError for other files, for a .glb that needs further files or shows nothing, and for invalid fields.
    """
    if not data.startswith(b"glTF"):
        raise FormatError(_ONLY_GLB)
    glb = _Glb(data)
    glb.document = without_record(glb.document)
    splats = level_digest(glb.container())[0]
    record = signed_record(key, splats_sha256=splats, file_sha256=glb.digest(), **terms)
    return b"".join(glb.with_record(record))


def sign_file(path: Path, out: Path, key: PrivateKey, **terms: Unpack[Terms]) -> None:
    """Apply ``sign_data`` to a file and write ``out``, which may be the same, atomically. Raises FormatError."""
    with naming(path):
        with open_regular(path) as (file, _):
            data = file.read()
        signed = sign_data(data, key, **terms)
    replace_file(out, [signed])


class _Glb:
    """The chunks of a GLB (glTF 2.0, 4.4). Raises FormatError."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        container = self.container()  # checks the lengths
        text, _ = chunks(io.BytesIO(data), len(data))
        try:
            document = json.loads(text.part(0, len(text)))
        except (ValueError, RecursionError):
            raise FormatError("the glTF JSON is broken") from None
        self.document: dict[str, Any] = document
        self._rest = data[text.start + len(text) : glb_length(data)]
        if any(buffer.uri is not None and not buffer.uri.startswith("data:") for buffer in container.gltf.buffers):
            raise FormatError(f"its buffers are files of their own; {_ONLY_GLB}")
        if any(isinstance(one, dict) and not _is_embedded(one.get("uri")) for one in container.gltf.images):
            raise FormatError(
                "its textures are files of their own; put them into the .glb, so that a consent covers them"
            )

    def container(self) -> Container:
        return read_container(io.BytesIO(self._data), len(self._data), None)

    def digest(self) -> str:
        return file_digest(self.document, self._rest)

    def with_record(self, record: dict[str, Any]) -> Iterable[bytes]:
        asset = self.document["asset"]
        extras = asset.setdefault("extras", {})
        note = extras.setdefault("glsplat", {}) if isinstance(extras, dict) else None
        if not isinstance(note, dict):
            raise FormatError("its asset.extras hold something else where a consent is kept; convert it with glsplat")
        note[CONSENT] = record
        text = json.dumps(self.document, separators=(",", ":"), ensure_ascii=False).encode()
        text += b" " * (-len(text) % 4)
        yield struct.pack("<III", MAGIC, 2, 20 + len(text) + len(self._rest))
        yield struct.pack("<II", len(text), JSON_CHUNK) + text
        yield self._rest


def _is_embedded(uri: Any) -> bool:
    return uri is None or (isinstance(uri, str) and uri.startswith("data:"))


def _is_own_file(data: bytes) -> bool:
    own = _own_files(len(data))
    return bool(own) and hashlib.sha256(data).digest() in own


@cache
def _own_files(size: int) -> frozenset[bytes]:
    """Return the SHA-256 of the package's own avatars and bodies of ``size`` bytes: synthetic people."""
    found, folders = set(), [resources.files("glsplat.data")]
    while folders:
        for one in folders.pop().iterdir():
            if one.is_dir():
                folders.append(one)
            elif one.name.endswith((".glb", ".npz")):
                data = one.read_bytes()
                if len(data) == size:
                    found.add(hashlib.sha256(data).digest())
    return frozenset(found)
