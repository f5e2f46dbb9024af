"""The registry of formats, and what is done with any of them: recognise, load, save."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import BinaryIO

import numpy as np

from glsplat.arrays import instance
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.compressed_ply import COMPRESSED_PLY
from glsplat.formats.files import Source, checked, folder_of, name_of, naming, open_regular, suffixes_of
from glsplat.formats.format import Format, Start
from glsplat.formats.gltf.splats import GLB, GLTF
from glsplat.formats.ksplat import KSPLAT
from glsplat.formats.ply import PLY
from glsplat.formats.sog.sog import SOG
from glsplat.formats.splat import SPLAT
from glsplat.formats.spz import SPZ
from glsplat.splats import Splats
from glsplat.views import splats_of

__all__ = ["FORMATS", "load", "losses", "recognise", "save", "suffixes"]

log = logging.getLogger("glsplat.formats")

FORMATS: list[Format] = [
    PLY,
    COMPRESSED_PLY,
    SPLAT,
    KSPLAT,
    SPZ,
    SOG,
    GLB,
    GLTF,
]
"""Every format, in the order in which messages name them. A new one is a module and a line here."""

_FOREIGN = {
    b"\x1f\x8b": "gzip, perhaps .spz or .ply.gz",
    b"NGSP": ".spz",
    b"PK": "a ZIP archive without the meta.json of a .sog",
}


def recognise(source: Source) -> str:
    """The name of the format (one of FORMATS), by content; FormatError when it is none of them.

    The name helps only where the content does not tell: .splat files have no mark of their own.
    """
    with naming(source), open_regular(source) as (file, size):
        return _recognised(file, size, suffixes_of(source)).name


def load(source: Source, *, strict: bool = False, format: str | None = None) -> Splats | Avatar:
    """Read a scene or an avatar from a path or from a file that is open in binary mode.

    The format is recognised by content, whatever the file's name, unless ``format`` says it, "ply" or another name
    in FORMATS. An open file is read from where it stands and stays open. A level of detail that is broken is left out,
    which is logged. With ``strict`` it is refused, as are NaN and infinity, which are kept otherwise. Raises
    FormatError, one line that names the file.

    >>> glsplat.save(glsplat.default_avatar(), "me.glb")
    >>> glsplat.load("me.glb")
    Avatar(40000 splats, 55 joints, 4 a splat, 3 levels)
    """
    with naming(source, strict), open_regular(source) as (file, size):
        known = _recognised(file, size, suffixes_of(source)) if format is None else _called(format)
        file.seek(0)
        scene = known.load(file, size, folder_of(source))
        checked(splats_of(scene), source, strict)
        return scene


def save(
    scene: Splats | Avatar,
    target: Source,
    *,
    format: str | None = None,
    say: Callable[[str], object] | None = None,
) -> None:
    """Write ``scene`` in the format of the suffix, .ply or another one in FORMATS, or of ``format``, "ply" and so on.

    ``target`` is a path, or a file open in binary mode, which is written to from where it stands. At a path the new
    file is complete or, on any failure, the old one as it was; a link is followed, an old file keeps its mode. An
    avatar goes into glTF with its rig; into the other formats go its splats alone, as they are stored: in the zero
    pose, or in the pose in which another program's rig was bound. What a file does not keep beyond rounding is told to
    ``say``, a sentence each; without it the log "glsplat.formats" has it as warnings. Raises FormatError for another
    suffix, and when the file cannot be written.

    >>> glsplat.save(glsplat.default_avatar().splats, "me.ply")
    >>> len(glsplat.load("me.ply"))
    40000
    """
    for loss in losses(scene, target, format=format):
        say(loss) if say is not None else log.warning("%s: %s", name_of(target), loss)
    with naming(target):
        _, write = _writer(target, format)
        with np.errstate(invalid="ignore"):  # a NaN that signals, wherever it is cast
            write(scene, target)


def losses(scene: Splats | Avatar, target: Source, *, format: str | None = None) -> Iterator[str]:
    """What ``save`` with the same arguments does not keep of ``scene``, beyond rounding, a sentence each."""
    instance(scene, (Splats, Avatar), "a file", hint="of a scene save the content of each item")
    with naming(target):
        known, _ = _writer(target, format)
    return known.losses(scene)


def suffixes(*, last: str = "or", rigs: bool = False, written: bool = False) -> str:
    """What names may end in, as texts say it: ".ply, .splat, .glb or .gltf".

    ``rigs``: those that hold avatars; ``written``: without those that are only read.
    """
    those = [known for known in FORMATS if (known.rigs or not rigs) and (known.save or not written)]
    return _either([suffix for known in those for suffix in known.suffixes], f" {last} ")


def _recognised(file: BinaryIO, size: int, endings: list[str]) -> Format:
    head = file.read(512)
    marked_first = sorted(FORMATS, key=lambda known: not known.marked)
    expected = _either(list(dict.fromkeys(known.title for known in marked_first)), ", or ")
    for known in marked_first:
        if not known.sniff(Start(head, size, any(ending in known.suffixes for ending in endings), file)):
            continue
        if known is GLTF and b'"items"' in head and b'"asset"' not in head:
            raise FormatError(f"expected {expected}, but this is a scene file; see glsplat.making.items.load_scene")
        return known
    if not head:
        raise FormatError(f"the file is empty; expected {expected}")
    foreign = next((name for magic, name in _FOREIGN.items() if head.startswith(magic)), None)
    raise FormatError(f"expected {expected}, but this is {foreign or 'none of them'}; convert it first")


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
