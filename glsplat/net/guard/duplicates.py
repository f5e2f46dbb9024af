"""Detect duplicate keys in JSON objects, of which decoders silently take the last value."""

from __future__ import annotations

import json
from typing import Any

import msgspec


class _DuplicateError(Exception):
    pass


def _once(pairs: list[tuple[str, Any]]) -> None:
    if len({key for key, _ in pairs}) != len(pairs):
        raise _DuplicateError


_plain = msgspec.json.Decoder()
# numbers are not parsed: Python refuses integers of 5000 digits
_exact = json.JSONDecoder(object_pairs_hook=_once, parse_int=len, parse_float=len, strict=False)


def has_duplicates(data: str | bytes) -> bool:
    """Return whether an object of this valid JSON text has a key twice, however the key is escaped.

    Every pair has one colon: where decoded objects have as many keys as the text has colons, no pair was lost. That
    costs a tenth of the exact check, which colons in strings make necessary.
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
    """Return the number of keys in ``value``, except in lists whose first member is no object."""
    if type(value) is dict:
        return len(value) + sum(_keys(v) for v in value.values() if type(v) is dict or type(v) is list)
    if type(value) is list and value and type(value[0]) is dict:
        return sum(map(_keys, value))
    return 0
