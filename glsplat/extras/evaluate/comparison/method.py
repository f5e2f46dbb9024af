"""Methods of making an avatar of a participant: the project's own, other packages', or a folder of files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.importers.bind import bind_to_mesh
from glsplat.extras.authoring.reconstruct.registry import Plugins
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.formats import all_formats, load_content
from glsplat.scene import Rigged
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
    _check_name(name)
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


def _check_name(name: str) -> None:
    """Raise GlsplatError unless a name can be a file name."""
    if not name or not all(part.isalnum() for part in name.replace("-", "_").split("_")) or len(name) > 40:
        raise GlsplatError(f"a method's name has letters, digits, - and _, not {name!r:.50}")
