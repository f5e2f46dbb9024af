"""The registry of formats, and what is done with any of them: recognise, load, save."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator

import numpy as np

from glsplat.arrays import instance
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.extras.formats.compressed_ply import COMPRESSED_PLY
from glsplat.extras.formats.ksplat import KSPLAT
from glsplat.extras.formats.obj import OBJ
from glsplat.extras.formats.person import PERSON
from glsplat.extras.formats.sog.sog import SOG
from glsplat.extras.formats.splat import SPLAT
from glsplat.extras.formats.spz import SPZ
from glsplat.formats.format import Format, Opened, opened
from glsplat.formats.gltf.splats import GLB, GLTF
from glsplat.formats.ply import PLY
from glsplat.io.files import Source, name_of, naming, suffixes_of
from glsplat.meshes import RiggedMesh
from glsplat.scene import Content
from glsplat.splats import Splats

__all__ = [
    "FORMATS",
    "is_scene_file",
    "load",
    "load_splats",
    "losses",
    "read",
    "recognise",
    "save",
    "suffixes",
]

log: logging.Logger = logging.getLogger("glsplat.formats")

FORMATS: list[Format] = [
    PLY,
    COMPRESSED_PLY,
    SPLAT,
    KSPLAT,
    SPZ,
    SOG,
    GLB,
    GLTF,
    OBJ,
    PERSON,
]
"""Every format, in the order in which messages name them. A new one is a module and a line here."""

_FOREIGN = {
    b"\x1f\x8b": "gzip, perhaps .spz or .ply.gz",
    b"NGSP": ".spz",
    b"PK": "a ZIP archive without the meta.json of a .sog",
}


def recognise(source: Source) -> str:
    """The name of the format (one of FORMATS), by content; FormatError when it is none of them.

    The name helps only where the content does not tell: .splat and OBJ files have no mark of their own.
    """
    with opened(source) as start:
        return _recognised(start).name


def load(source: Source, *, strict: bool = False, format: str | None = None) -> Content:
    """As ``glsplat.load``, without scene files: splats, an avatar or a mesh."""
    with opened(source, strict) as start:
        return read(start, strict, format)


def load_splats(source: Source, *, strict: bool = False, format: str | None = None) -> Splats | Avatar:
    """The same of a file that needs to hold splats; FormatError for a mesh."""
    with opened(source, strict) as start:
        content = read(start, strict, format)
        if isinstance(content, RiggedMesh):
            raise FormatError("expected splats or an avatar, found a mesh; glsplat avatar make makes an avatar of one")
        return content


def read(start: Opened, strict: bool, format: str | None = None) -> Content:
    """What an open file holds, in the format that it is recognised by, or in that called ``format``."""
    return (_recognised(start) if format is None else _called(format)).read(start, strict)


def save(
    scene: Content,
    target: Source,
    *,
    format: str | None = None,
    say: Callable[[str], object] | None = None,
) -> None:
    """Write ``scene`` in the format of the suffix, .ply or another one in FORMATS, or of ``format``, "ply" and so on.

    ``target`` is a path, or a file open in binary mode, which is written to from where it stands. At a path the new
    file is complete or, on any failure, the old one as it was; a link is followed, an old file keeps its mode. An
    avatar goes into glTF with its rig, a mesh goes nowhere else; into the other formats go an avatar's splats alone, as
    they are stored: in the zero pose, or in the pose in which another program's rig was bound. What a file does not
    keep beyond rounding is told to ``say``, a sentence each; without it the log "glsplat.formats" has it as warnings.
    Raises FormatError for another suffix, and when the file cannot be written.

    >>> glsplat.save(glsplat.default_avatar().splats, "me.ply")
    >>> len(glsplat.load("me.ply"))
    40000
    """
    for loss in losses(scene, target, format=format):
        say(loss) if say is not None else log.warning("%s: %s", name_of(target), loss)
    with naming(target), np.errstate(invalid="ignore"):  # a NaN that signals, wherever it is cast
        known, write = _writer(target, format)
        if not isinstance(scene, RiggedMesh):
            write(scene, target)
        elif known.save_mesh is not None:
            known.save_mesh(scene, target)


def losses(scene: Content, target: Source, *, format: str | None = None) -> Iterator[str]:
    """What ``save`` with the same arguments does not keep of ``scene``, beyond rounding, a sentence each."""
    instance(scene, (Splats, Avatar, RiggedMesh), "a file", hint="of a scene save the content of each item")
    with naming(target):
        known, _ = _writer(target, format)
        if isinstance(scene, RiggedMesh) and known.save_mesh is None:
            those = _either([suffix for one in FORMATS if one.save_mesh for suffix in one.suffixes], " or ")
            raise FormatError(f"a mesh is written as {those}; change the name")
    return iter(()) if isinstance(scene, RiggedMesh) else known.losses(scene)


def suffixes(*, last: str = "or", rigs: bool = False, written: bool = False) -> str:
    """What names may end in, as texts say it: ".ply, .splat, .glb or .gltf".

    ``rigs``: those that hold avatars; ``written``: without those that are only read.
    """
    those = [known for known in FORMATS if (known.rigs or not rigs) and (known.save or not written)]
    return _either([suffix for known in those for suffix in known.suffixes], f" {last} ")


def _recognised(start: Opened) -> Format:
    """The format of an open file. Raises FormatError when it is none of FORMATS."""
    if is_scene_file(start):
        raise FormatError("this is a scene file, which names several things; glsplat.load reads it")
    marked_first = sorted(FORMATS, key=lambda known: not known.marked)
    for known in marked_first:
        if known.sniff(start):
            return known
    expected = _either(list(dict.fromkeys(known.title for known in marked_first)), ", or ")
    if not start.head:
        raise FormatError(f"the file is empty; expected {expected}")
    foreign = next((name for magic, name in _FOREIGN.items() if start.head.startswith(magic)), None)
    raise FormatError(f"expected {expected}, but this is {foreign or 'none of them'}; convert it first")


def is_scene_file(start: Opened) -> bool:
    """Whether a file is a scene file (JSON with items; scenes/scene_file.py) and not of another JSON format."""
    text = start.json
    return bool(re.search(rb'"items"\s*:', text) and not re.search(rb'"asset"\s*:', text))


def _called(name: str) -> Format:
    wanted = name.lower().removeprefix(".") if isinstance(name, str) else ""
    for known in FORMATS:
        if known.name == wanted or f".{wanted}" in known.suffixes:
            return known
    raise FormatError(f"format is one of {', '.join(known.name for known in FORMATS)}, not {name!r:.40}")


def _writer(target: Source, name: str | None) -> tuple[Format, Callable[[Splats | Avatar, Source], None]]:
    """The format that ``target`` is written in, and how."""
    known = _by_suffixes(suffixes_of(target)) if name is None else _called(name)
    if known.save is None:
        raise FormatError(f"{known.title} is read, not written; choose {suffixes(written=True)}")
    return known, known.save


def _by_suffixes(endings: list[str]) -> Format:
    for ending in endings:
        for known in FORMATS:
            if ending in known.suffixes:
                return known
    found = endings[-1][:20]
    raise FormatError(f"the name needs to end in {suffixes(written=True)}, not {found!r}; or say which by format")


def _either(names: list[str], last: str) -> str:
    return last.join([*([", ".join(names[:-1])] if len(names) > 1 else []), *names[-1:]])
