"""The place of the consent record in a .glb, the signed bytes and the hash of the file.

The record is an opaque object here; `document` reads its fields.
"""

from __future__ import annotations

import copy
import hashlib
import json
from typing import Any

from glsplat.errors import FormatError
from glsplat.formats.gltf.output import CONSENT


def canonical(value: Any) -> bytes:
    """Return JSON with sorted keys, without spaces, in UTF-8. Raises FormatError for text that is not Unicode."""
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
    except (UnicodeEncodeError, RecursionError):
        raise FormatError("needs JSON of Unicode text that is not nested too deeply") from None


def file_digest(document: dict[str, Any], rest: bytes) -> str:
    """Return the SHA-256 (hex) of the ``canonical`` JSON without its record, a zero byte, and ``rest`` of the .glb."""
    return hashlib.sha256(canonical(without_record(document)) + b"\0" + rest).hexdigest()


def is_of(record: dict[str, Any], document: dict[str, Any], rest: bytes) -> bool:
    """Return whether a record was signed for the .glb with that JSON and ``rest``."""
    return bool(record.get("file_sha256") == file_digest(document, rest))


def record_of(document: dict[str, Any]) -> Any:
    """Return the record in a file's JSON; it may be a line of text. None without one."""
    found: Any = document
    for key in ("asset", "extras", "glsplat", CONSENT):
        found = found.get(key) if isinstance(found, dict) else None
    return found


def without_record(document: dict[str, Any]) -> dict[str, Any]:
    """Return a copy of the JSON without the record and without objects that held nothing else."""
    out = dict(document)
    asset = out.get("asset")
    if isinstance(asset, dict) and isinstance(asset.get("extras"), dict):
        asset = out["asset"] = copy.deepcopy(asset)
        note = asset["extras"].get("glsplat")
        if isinstance(note, dict):
            note.pop(CONSENT, None)
            if not note:
                del asset["extras"]["glsplat"]
        if not asset["extras"]:
            del asset["extras"]
    return out
