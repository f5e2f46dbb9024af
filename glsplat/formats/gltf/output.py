"""Write glTF 2.0: accessors and bufferViews of one buffer, as a GLB or as JSON with the buffer in it."""

from __future__ import annotations

import base64
import logging
import struct
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import BINARY_CHUNK, JSON_CHUNK, MAGIC
from glsplat.formats.gltf.schema import Accessor, Asset, Buffer, BufferView, Gltf
from glsplat.io.files import Source, left_out, naming, replace_file, suffix_of
from glsplat.optional import plugin

VERTICES, INDICES = 34962, 34963
"""Targets of bufferViews: ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER."""

CONSENT = "consent"
"""In asset.extras.glsplat: a signed record (an object; docs/consent.md), or a line of text."""

UNLIT = "KHR_materials_unlit"

log: logging.Logger = logging.getLogger("glsplat.formats")


class Output:
    """The file being written: collects accessors, each in its own bufferView, aligned to 4 bytes."""

    def __init__(self) -> None:
        self.gltf: Gltf = Gltf()
        self.parts: list[bytes] = []
        self._length = 0

    def add(
        self,
        array: NDArray[Any],
        kind: str,
        *,
        bounds: bool = False,
        normalized: bool = False,
        target: int | None = VERTICES,
    ) -> int:
        """Add an accessor of type ``kind`` for [N, width] floats of 32 bits or integers of 8 to 32; return its index.

        ``normalized`` integers stand for -1 to 1 or 0 to 1. ``target`` is the bufferView's: ``VERTICES``, ``INDICES``
        or None.
        """
        code = {"f": 5126, "b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125}[array.dtype.char]
        data = array.astype(array.dtype.newbyteorder("<")).tobytes()
        accessor = Accessor(buffer_view=self.add_bytes(data, target), component_type=code, count=len(array), type=kind)
        accessor.normalized = normalized
        finite = array[np.isfinite(array).all(axis=1)]
        if bounds and len(finite):  # required for POSITION; NaN and infinity are not JSON
            accessor.min, accessor.max = finite.min(axis=0).tolist(), finite.max(axis=0).tolist()
        self.gltf.accessors.append(accessor)
        return len(self.gltf.accessors) - 1

    def add_shares(self, array: NDArray[np.float32], kind: str) -> int:
        """Add [N, 4] floats from 0 to 1, as normalised integers of 8 or 16 bits where that loses nothing."""
        for code in (np.uint8, np.uint16):
            full = np.float32(np.iinfo(code).max)
            with np.errstate(invalid="ignore", over="ignore"):
                narrow = np.clip(np.nan_to_num(np.rint(array * full)), 0, full).astype(code)
            if np.array_equal(narrow.astype(np.float32) / full, array):
                return self.add(narrow, kind, normalized=True)
        return self.add(array, kind)

    def add_bytes(self, data: bytes, target: int | None = None) -> int:
        """Add a bufferView that holds ``data``, of an accessor or an image file; return its index."""
        view = BufferView(buffer=0, byte_offset=self._length, byte_length=len(data), target=target)
        self.gltf.buffer_views.append(view)
        padded = data + b"\0" * (-len(data) % 4)
        self.parts.append(padded)
        self._length += len(padded)
        return len(self.gltf.buffer_views) - 1

    def needs(self, extension: str) -> None:
        """Add an extension that readers have to support."""
        for named in (self.gltf.extensions_used, self.gltf.extensions_required):
            if extension not in named:
                named.append(extension)

    def note(self, values: dict[str, Any]) -> None:
        """Set the metadata that ``Container.note`` returns."""
        self.gltf.asset = Asset(version="2.0", generator="glsplat", extras={"glsplat": values})

    def write(self, target: Source, *, embedded: bool | None = None) -> None:
        """Write a .glb, or where ``target`` ends in .gltf one JSON file with its buffer ``embedded``.

        A consent that was signed for other content is left out, with a warning.
        """
        blob = b"".join(self.parts)
        self.gltf.buffers = [Buffer(byte_length=len(blob))]
        embedded = suffix_of(target) == ".gltf" if embedded is None else embedded
        with naming(target):
            self._check_consent(blob, embedded)
            if embedded:
                self.gltf.buffers[0].uri = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
                replace_file(target, [msgspec.json.format(_encode(self.gltf), indent=1)])
            else:
                text = _encode(self.gltf)
                text += b" " * (-len(text) % 4)
                head = struct.pack("<III", MAGIC, 2, 12 + 8 + len(text) + 8 + len(blob))
                head += struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(blob), BINARY_CHUNK)
                replace_file(target, [head, blob])

    def _check_consent(self, blob: bytes, embedded: bool) -> None:
        note = self.gltf.asset.extras["glsplat"] if isinstance(self.gltf.asset.extras, dict) else {}
        if not isinstance(signed := note.get(CONSENT), dict):
            return
        record = plugin("consent.record")
        document = msgspec.json.decode(_encode(self.gltf))
        rest = struct.pack("<II", len(blob), BINARY_CHUNK) + blob
        if embedded or record is None or not record.is_of(signed, document, rest):
            del note[CONSENT]
            why = "it was signed for other content; sign it anew"
            why = "only glsplat.extras.consent, which is not installed, checks it" if record is None else why
            left_out(log, f"the consent is left out: {'only a .glb carries one' if embedded else why}")


def _encode(gltf: Gltf) -> bytes:
    try:
        return msgspec.json.encode(gltf)
    except (TypeError, ValueError, RecursionError) as error:
        raise FormatError(f"the metadata of an avatar needs to be JSON ({str(error)[:80]})") from None


def unlit_material(name: str) -> dict[str, Any]:
    """Return a material that shows colours as they are; without KHR_materials_unlit it is rough, no metal."""
    return {
        "name": name,
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
        "extensions": {UNLIT: {}},
    }
