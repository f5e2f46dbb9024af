"""Products: the avatar that a method made of a participant, cached as a file."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError, one_line
from glsplat.extras.evaluate.comparison.method import MadeElsewhere, method_named, read_figure
from glsplat.extras.evaluate.comparison.participant import Participant, digest_of
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import save
from glsplat.formats.registry import load
from glsplat.io.files import replace_file
from glsplat.scene import Rigged, is_rigged


@dataclass(frozen=True, eq=False)
class Product:
    """An avatar, and facts about its making."""

    figure: Rigged
    facts: Mapping[str, Any]
    """kind ("splats" or "triangles"), count, bytes of the file, seconds of making (None: made elsewhere)."""


def product(
    name: str, source: str | MadeElsewhere, participant: Participant, out: Path, options: Mapping[str, Any]
) -> Product:
    """Make the avatar of a participant by the method ``name``, or load it from ``out`` if its inputs are unchanged.

    Either way the avatar is read from its file, so that a resumed run gives the same results. Raises GlsplatError
    with one line, also for any error of another package's method.
    """
    file, note = out / f"{participant.name}.glb", out / f"{participant.name}.json"
    wanted = {**key_of(source, participant), **options}
    kept = _note(note)
    if kept.get("key") != wanted or not file.is_file() or kept.get("sha256") != digest_of(file):
        began = time.perf_counter()
        made = _made(name, source, participant, options)
        seconds = None if isinstance(source, MadeElsewhere) else round(time.perf_counter() - began, 1)
        out.mkdir(parents=True, exist_ok=True)
        figure = _checked(made, name)
        if isinstance(figure, Avatar):
            save(figure, file)
        else:
            save_gltf_mesh(figure, file)
        kept = {"key": wanted, "seconds": seconds, "sha256": digest_of(file)}
        replace_file(note, [json.dumps(kept).encode()])
    figure = _checked(load(file), name)
    return Product(figure, _facts(figure, file.stat().st_size, kept["seconds"]))


def key_of(source: str | MadeElsewhere, participant: Participant) -> dict[str, Any]:
    """Return an avatar's inputs besides options and code. Raises FormatError for missing files."""
    key: dict[str, Any] = {"glsplat": version("glsplat"), "participant": participant.digest()}
    if isinstance(source, MadeElsewhere):
        return {**key, "file": digest_of(source.file_of(participant))}
    return {**key, "method": source}


def _made(name: str, source: str | MadeElsewhere, participant: Participant, options: Mapping[str, Any]) -> Any:
    method = source if isinstance(source, MadeElsewhere) else method_named(source, options)
    try:
        made = method.make(participant)
        return read_figure(Path(made), participant) if isinstance(made, (str, os.PathLike)) else made
    except GlsplatError:
        raise
    except Exception as error:
        raise GlsplatError(f'the method "{name}" failed on {participant.name}: {one_line(error)}') from error


def _checked(figure: Any, name: str) -> Rigged:
    if not is_rigged(figure):
        raise FormatError(f'the method "{name}" returned {figure!r:.80}, not an avatar or a mesh with a skeleton')
    return figure


def _facts(figure: Rigged, size: int | None, seconds: float | None) -> dict[str, Any]:
    splats = isinstance(figure, Avatar)
    count = len(figure.splats) if isinstance(figure, Avatar) else len(figure.faces)
    return {"kind": "splats" if splats else "triangles", "count": count, "bytes": size, "seconds": seconds}


def _note(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}
