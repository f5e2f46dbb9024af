"""Methods: what makes an avatar of a participant. The project's own, other packages', or a folder of files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.importers.bind import bind_to_mesh
from glsplat.extras.authoring.reconstruct.plugins import Plugins
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.formats import all_formats, load_content
from glsplat.scene import Rigged
from glsplat.splats import Splats

GROUP = "glsplat.methods"
"""Other packages name here, as an entry point, what gives a Method when it is called without arguments."""

OWN = {
    "photo": "glsplat.extras.evaluate.comparison.own_methods:Photo",
    "mesh-image": "glsplat.extras.evaluate.comparison.own_methods:MeshImage",
    "mesh-video": "glsplat.extras.evaluate.comparison.own_methods:MeshVideo",
    "scan": "glsplat.extras.evaluate.comparison.own_methods:Scan",
}

# files with a rig count before those without
_FORMATS = sorted((form for form in all_formats().values() if form.load), key=lambda form: not form.rigs)
_SUFFIXES = tuple(s for form in _FORMATS for s in form.suffixes if s.startswith("."))
PLUGINS = Plugins("method", GROUP, "make", OWN)


class Method(Protocol):
    """Makes an avatar of a person, from nothing but what was captured of them; ``scan`` alone looks at the truth."""

    def make(self, participant: Participant) -> Rigged | str | Path:
        """An avatar or a rigged mesh in its zero pose, soles on y = 0, facing +z, metres; or the path of one.

        Raises GlsplatError in one line where it cannot: that participant's row then says so.
        """


@dataclass(frozen=True)
class MadeElsewhere:
    """Files made elsewhere: NAME.glb or of another format of splats, or NAME.npz, for the participant NAME.

    Splats without a skeleton are bound to the nearest surface of the participant's own mesh, which favours them.
    """

    folder: Path

    def make(self, participant: Participant) -> Rigged:
        """The file, read. Raises FormatError."""
        return read_figure(self.file_of(participant), participant)

    def file_of(self, participant: Participant) -> Path:
        """That participant's file. Raises FormatError where there is none."""
        found = [file for suffix in _SUFFIXES if (file := self.folder / f"{participant.name}{suffix}").is_file()]
        if not found:
            names = ", ".join(_SUFFIXES)
            raise FormatError(f"{self.folder}: no file of {participant.name} (one of {names})")
        return found[0]


def read_figure(file: Path, participant: Participant) -> Rigged:
    """An avatar or mesh of a file; splats without a skeleton are bound to the participant's mesh. FormatError."""
    content = load_content(file)
    return bind_to_mesh(content, participant.mesh) if isinstance(content, Splats) else content


def method_of(word: str) -> tuple[str, str | MadeElsewhere]:
    """Name and what to call of a word of the command line: ``name`` (see OWN, GROUP) or ``name=FOLDER``."""
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
    """Load a method; the project's own take ``options`` (seed, quick). Raises GlsplatError, one line."""
    method = PLUGINS.named(name)
    if name in OWN:
        method = replace(method, **options)
    made: Method = method
    return made


def _check_name(name: str) -> None:
    """Names become file names. Raises GlsplatError."""
    if not name or not all(part.isalnum() for part in name.replace("-", "_").split("_")) or len(name) > 40:
        raise GlsplatError(f"a method's name has letters, digits, - and _, not {name!r:.50}")
