"""Recordings: tracking samples as JSON Lines, one object a line."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from importlib import resources
from math import isfinite
from pathlib import Path
from typing import Any

from glsplat.errors import FormatError, PoseError
from glsplat.io.files import open_regular, replace_file
from glsplat.tracking.sample import Sample

MAX_LINE_BYTES = 1 << 20
DECIMALS = 6  # of written numbers


def record(path: str | Path, samples: Iterable[Sample]) -> int:
    """Write samples and return their number; the file appears when it is complete."""
    return write_lines(path, (sample.to_json() for sample in samples))


def replay(path: str | Path) -> Iterator[Sample]:
    """Yield the samples of a recording in the file's order; the tracker judges their time stamps.

    Raises FormatError naming file and line for what is not a sample.
    """
    for number, data in json_lines(path):
        if isinstance(data, dict) and data.get("t") is None:
            raise FormatError(f"{path}, line {number}: a recorded sample needs its time, t in seconds")
        try:
            yield Sample.from_json(data)
        except PoseError as error:
            raise FormatError(f"{path}, line {number}: {error}") from None


def embedded_recording() -> list[Sample]:
    """Return the recording that comes with glsplat: 72 Hz, derived from its own motions."""
    with resources.as_file(resources.files("glsplat.data").joinpath("recording.jsonl")) as path:
        return list(replay(path))


def write_lines(path: str | Path, objects: Iterable[dict[str, Any]]) -> int:
    """Write JSON Lines with numbers rounded to DECIMALS, NaN as null; return the number of lines."""
    count = 0

    def lines() -> Iterator[bytes]:
        nonlocal count
        for item in objects:
            count += 1
            yield json.dumps(_rounded(item), separators=(",", ":")).encode() + b"\n"

    replace_file(path, lines())
    return count


def json_lines(path: str | Path) -> Iterator[tuple[int, Any]]:
    """Yield line numbers and objects of JSON Lines. Raises FormatError naming file and line."""
    with open_regular(path) as (file, _):
        for number, line in enumerate(iter(lambda: file.readline(MAX_LINE_BYTES + 1), b""), 1):
            if len(line) > MAX_LINE_BYTES:
                raise FormatError(f"{path}, line {number}: a line has at most {MAX_LINE_BYTES >> 10} KiB")
            if not line.strip():
                continue
            try:
                yield number, json.loads(line)
            except (ValueError, RecursionError) as error:
                raise FormatError(
                    f"{path}, line {number}: a recording holds one JSON object a line, but {error}"
                ) from None


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DECIMALS) if isfinite(value) else None
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    return value
