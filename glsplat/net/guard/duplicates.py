"""Objects that give a key twice, which JSON decoders silently read as its last value."""

from __future__ import annotations

import json
from typing import Any

import msgspec

__all__ = ["has_duplicates"]


class _DuplicateError(Exception):
    pass


def _once(pairs: list[tuple[str, Any]]) -> None:
    if len({key for key, _ in pairs}) != len(pairs):
        raise _DuplicateError


_plain = msgspec.json.Decoder()
# numbers are not looked at: a whole number of 5000 digits would be an error of Python's own
_exact = json.JSONDecoder(object_pairs_hook=_once, parse_int=len, parse_float=len, strict=False)


def has_duplicates(data: str | bytes) -> bool:
    """True if an object of this valid JSON text gives a key twice, however the key is escaped.

    Every pair has one colon, so a text whose objects, once read, hold as many keys as it has colons has no pair too
    many: that costs a tenth of what reading pair by pair does. Colons in strings only lead to the slow way.
    """
    text = data if isinstance(data, str) else data.decode("utf-8", "replace")
    if _keys(_plain.decode(text)) == text.count(":"):
        return False
    try:
        _exact.decode(text)
    except _DuplicateError:
        return True
    return False


def _keys(value: Any) -> int:
    """Keys of the objects in ``value``; those in lists that begin with something else are left out."""
    if type(value) is dict:
        return len(value) + sum(_keys(v) for v in value.values() if type(v) is dict or type(v) is list)
    if type(value) is list and value and type(value[0]) is dict:
        return sum(map(_keys, value))
    return 0
