"""Methods of making an avatar of a participant, and their products, cached as files.

A method is the project's own, another package's, or a folder of files.
"""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError, one_line
from glsplat.extras.authoring.importers.bind import bind_to_mesh
from glsplat.extras.authoring.reconstruct.registry import Plugins
from glsplat.extras.evaluate.comparison.participant import Participant, digest_of
from glsplat.extras.rigs.meshes.write import save_gltf_mesh
from glsplat.formats import all_formats, load_content, save
from glsplat.formats.registry import load
from glsplat.io.files import replace_file
from glsplat.scene import Rigged, is_rigged
from glsplat.splats import Splats

GROUP = "glsplat.methods"
"""Entry point group of other packages; an entry is called without arguments and returns a Method."""

OWN = {
    "photo": "glsplat.extras.evaluate.comparison.own_methods:Photo",
    "mesh-image": "glsplat.extras.evaluate.comparison.own_methods:MeshImage",
    "mesh-video": "glsplat.extras.evaluate.comparison.own_methods:MeshVideo",
    "scan": "glsplat.extras.evaluate.comparison.own_methods:Scan",
}

# prefer files with a rig
_FORMATS = sorted((form for form in all_formats().values() if form.load), key=lambda form: not form.rigs)
_SUFFIXES = tuple(s for form in _FORMATS for s in form.suffixes if s.startswith("."))
PLUGINS = Plugins("method", GROUP, "make", OWN)


class Method(Protocol):
    """Makes an avatar of a person from their captured data alone; only ``scan`` uses the truth."""

    def make(self, participant: Participant) -> Rigged | str | Path:
        """Return an avatar or a rigged mesh in its zero pose, soles on y = 0, facing +z, metres; or the path of one.

        Raises GlsplatError with one line, which the participant's row shows.
        """


@dataclass(frozen=True)
class MadeElsewhere:
    """Files made elsewhere for the participant NAME: NAME.glb, NAME.npz or another format of splats.

    Splats without a skeleton are bound to the nearest surface of the participant's own mesh, which favours them.
    """

    folder: Path

    def make(self, participant: Participant) -> Rigged:
        """Read and return the participant's figure. Raises FormatError."""
        return read_figure(self.file_of(participant), participant)

    def file_of(self, participant: Participant) -> Path:
        """Return the participant's file. Raises FormatError if there is none."""
        found = [file for suffix in _SUFFIXES if (file := self.folder / f"{participant.name}{suffix}").is_file()]
        if not found:
            names = ", ".join(_SUFFIXES)
            raise FormatError(f"{self.folder}: no file of {participant.name} (one of {names})")
        return found[0]


def read_figure(file: Path, participant: Participant) -> Rigged:
    """Return the avatar or mesh in a file, with unrigged splats bound to the participant's mesh. Raises FormatError."""
    content = load_content(file)
    return bind_to_mesh(content, participant.mesh) if isinstance(content, Splats) else content


def method_of(word: str) -> tuple[str, str | MadeElsewhere]:
    """Parse ``name`` (see OWN, GROUP) or ``name=FOLDER`` into a name and a method. Raises GlsplatError."""
    name, given, folder = word.partition("=")
    if len(name) > 40 or not re.fullmatch(r"[^\W_]+([-_][^\W_]+)*", name):  # it becomes a file name
        raise GlsplatError(f"a method's name has letters, digits, - and _, not {name!r:.50}")
    if not given:
        if name not in PLUGINS.names():
            raise GlsplatError(f'no method is called "{name}"; there are {", ".join(PLUGINS.names())}, or NAME=FOLDER')
        return name, name
    if name in PLUGINS.names():
        raise GlsplatError(f'"{name}" is a method of its own; give the folder {folder} another name')
    if not Path(folder).is_dir():
        raise FormatError(f"{folder}: no such folder; a method of your own is NAME=FOLDER with a file a participant")
    return name, MadeElsewhere(Path(folder).resolve())


def method_named(name: str, options: Mapping[str, Any]) -> Method:
    """Load a method; the project's own take ``options`` (seed, quick). Raises GlsplatError."""
    method = PLUGINS.named(name)
    if name in OWN:
        method = replace(method, **options)
    made: Method = method
    return made


def product(
    name: str, source: str | MadeElsewhere, participant: Participant, out: Path, options: Mapping[str, Any]
) -> tuple[Rigged, dict[str, Any]]:
    """Make the avatar of a participant by the method ``name``, or load it from ``out`` if its inputs are unchanged.

    Returned with it are its kind ("splats" or "triangles"), count, bytes of the file, and seconds of making (None: made
    elsewhere).

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
    count = len(figure.splats) if isinstance(figure, Avatar) else len(figure.faces)
    kind = "splats" if isinstance(figure, Avatar) else "triangles"
    facts = {"kind": kind, "count": count, "bytes": file.stat().st_size, "seconds": kept["seconds"]}
    return figure, facts


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


def _note(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return data if isinstance(data, dict) else {}
