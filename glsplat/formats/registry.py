"""The registry of formats: one sniff over all of them, one ``load`` and one ``save``."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module, resources

import numpy as np

from glsplat.arrays import instance
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.format import Format, Opened, opened
from glsplat.io.files import Source, name_of, naming, suffixes_of
from glsplat.meshes import RiggedMesh
from glsplat.optional import missing, plugin
from glsplat.scene import Content, Scene
from glsplat.splats import Splats

log: logging.Logger = logging.getLogger("glsplat.formats")

# modules whose add_formats() puts rows into the registry; of extras, NAME is glsplat.extras.NAME.rows
_CORE = (
    "glsplat.formats.ply",
    "glsplat.formats.gltf.splats",
    "glsplat.formats.motion_files",
    "glsplat.formats.scene_file",
)
_EXTRAS = ("formats", "rigs", "motions")

# for the message where an extra is not installed
_SUFFIXES_OF_EXTRAS = {
    "formats": (".compressed.ply", ".splat", ".ksplat", ".spz", ".sog", "meta.json", ".obj", ".npz"),
    "motions": (".bvh", ".amc"),
}
_FOREIGN = {
    b"\x1f\x8b": "gzip, perhaps .spz or .ply.gz",
    b"NGSP": ".spz",
    b"PK": "a ZIP archive without the meta.json of a .sog",
}


@cache
def all_formats() -> dict[str, Format]:
    """Return every format by its name; a row added to this dictionary is used by this process.

    A row may replace an earlier one of its name. Later rows are sniffed first, as they are the more special formats.
    """
    found: dict[str, Format] = {}
    for module in (*map(import_module, _CORE), *(plugin(f"{name}.rows") for name in _EXTRAS)):
        if module is not None:
            module.add_formats(found)
    return found


def recognise(source: Source) -> str:
    """Return the name of a file's format, by its content; FormatError where it is none of ``all_formats()``.

    The suffix counts only for formats without a mark of their own: .splat, .obj.
    """
    with opened(source) as start:
        return recognised(start).name


def load(source: Source, *, strict: bool = False, format: str | None = None) -> Content | Scene:
    """Read splats, an avatar, a mesh or a scene file from a path or from a file that is open in binary mode.

    The format is recognised by content, whatever the file's name, unless ``format`` names it: "ply" or another key of
    ``glsplat.formats.all_formats()``. Splats with a skin are an Avatar; a mesh of triangles (glTF, VRM, OBJ, a person
    in .npz) is a RiggedMesh, on one joint where nothing moves it; a scene file is a Scene, whose background and motions
    ``glsplat.formats.load_scene`` has. An open file is read from where it stands and stays open. A level of detail that
    is broken is left out, which is logged. With ``strict`` it is refused, as are NaN and infinity, which are kept or
    mended otherwise. Raises FormatError, one line that names the file.

    >>> glsplat.save(glsplat.default_avatar(), "me.glb")
    >>> glsplat.load("me.glb")
    Avatar(40000 splats, 55 joints, 4 a splat, 52 shapes, 3 levels)
    """
    if isinstance(source, str) and source.isidentifier() and not os.path.exists(source):
        if (resources.files("glsplat.data") / "people" / f"{source}.glb").is_file():
            raise FormatError(f'{source}: no such file; an embedded avatar is glsplat.data.person("{source}")')
    with opened(source, strict) as start:
        return recognised(start, format).read(start)


def load_content(source: Source, *, strict: bool = False, format: str | None = None) -> Content:
    """Read splats, an avatar or a mesh as ``load`` does; FormatError for a scene file, before it opens others."""
    with opened(source, strict) as start:
        known = recognised(start, format)
        content = None if known.name == "scene" else known.read(start)
        if content is None or isinstance(content, Scene):
            raise FormatError("expected one thing, found a scene file, which names several")
        return content


def load_splats(source: Source, *, strict: bool = False, format: str | None = None) -> Splats | Avatar:
    """Read splats or an avatar; FormatError for a mesh or a scene file."""
    content = load_content(source, strict=strict, format=format)
    if isinstance(content, RiggedMesh):
        found = "expected splats or an avatar, found a mesh; glsplat avatar make makes an avatar of one"
        raise FormatError(f"{name_of(source)}: {found}")
    return content


def save(
    scene: Content,
    target: Source,
    *,
    format: str | None = None,
    say: Callable[[str], object] | None = None,
) -> None:
    """Write ``scene`` in the format of the suffix, .ply or another key of ``all_formats()``, or in that of ``format``.

    ``target`` is a path, or a file open in binary mode, which is written to from where it stands. At a path the new
    file is complete or, on any failure, the old one as it was; a link is followed, an old file keeps its mode. An
    avatar goes into glTF with its rig, a mesh goes nowhere else; into the other formats go an avatar's splats alone, as
    they are stored: in the zero pose, or in the pose in which another program's rig was bound. What a file does not
    keep beyond rounding is passed to ``say``, a sentence each; without it, logged to "glsplat.formats" as warnings.
    Raises FormatError for another suffix, and when the file cannot be written.

    >>> glsplat.save(glsplat.default_avatar().splats, "me.ply")
    >>> len(glsplat.load("me.ply"))
    40000
    """
    for loss in losses(scene, target, format=format):
        say(loss) if say is not None else log.warning("%s: %s", name_of(target), loss)
    with naming(target), np.errstate(invalid="ignore"):  # casting a signalling NaN warns
        known = _writer(scene, target, format)
        write = known.save_mesh if isinstance(scene, RiggedMesh) else known.save
        assert write is not None
        write(scene, target)  # type: ignore[arg-type]


def losses(scene: Content, target: Source, *, format: str | None = None) -> Iterator[str]:
    """Yield a sentence for each thing that ``save`` with the same arguments does not keep of ``scene``."""
    instance(scene, (Splats, Avatar, RiggedMesh), "a file", hint="of a scene save the content of each item")
    with naming(target):
        known = _writer(scene, target, format)
    return iter(()) if isinstance(scene, RiggedMesh) else known.losses(scene)


def suffixes(*, last: str = "or", rigs: bool = False, written: bool = False) -> str:
    """Return the suffixes of files that ``load`` reads, for texts: ".ply, .splat, .glb or .gltf".

    ``rigs``: of formats that hold avatars; ``written``: of those that ``save`` writes.
    """
    those = [f for f in all_formats().values() if f.load and (f.rigs or not rigs) and (f.save or not written)]
    return _listed([suffix for known in those for suffix in known.suffixes], f" {last} ")


def recognised(start: Opened, format: str | None = None) -> Format:
    """Return the format of an open file, or that called ``format``. Raises FormatError where it is none."""
    if format is not None:
        return _called(format)
    if found := sniffed(start):
        return found
    for extra, endings in _SUFFIXES_OF_EXTRAS.items():
        if start.named(*endings) and plugin(f"{extra}.rows") is None:
            raise FormatError(missing(extra, f"the format {start.endings[0]}"))
    titles = [one.title for one in all_formats().values() if one.load]
    expected = _listed(list(dict.fromkeys(titles)), ", or ")
    if not start.head:
        raise FormatError(f"the file is empty; expected {expected}")
    foreign = next((name for magic, name in _FOREIGN.items() if start.head.startswith(magic)), None)
    raise FormatError(f"expected {expected}, but this is {foreign or 'none of them'}; convert it first")


def sniffed(start: Opened) -> Format | None:
    """Return the format of an open file; None where it is none."""
    known = sorted(reversed(all_formats().values()), key=lambda known: not known.marked)
    return next((one for one in known if one.sniff(start)), None)


def _called(name: str) -> Format:
    wanted = name.lower().removeprefix(".") if isinstance(name, str) else ""
    for known in all_formats().values():
        if known.name == wanted or f".{wanted}" in known.suffixes:
            return known
    raise FormatError(f"format is one of {', '.join(all_formats())}, not {name!r:.40}")


def _writer(scene: Content, target: Source, name: str | None) -> Format:
    """Return the format that ``target`` is written in. Raises FormatError where it does not hold such a scene."""
    known = _called(name) if name is not None else _of_suffix(suffixes_of(target))
    if isinstance(scene, RiggedMesh):
        if known.save_mesh is None:
            those = [suffix for one in all_formats().values() if one.save_mesh for suffix in one.suffixes]
            hint = f"a mesh is written as {_listed(those, ' or ')}; change the name"
            raise FormatError(hint if those else "a mesh is written by glsplat.extras.rigs, which is not installed")
    elif known.save is None:
        raise FormatError(f"{known.title} is read, not written; choose {suffixes(written=True)}")
    return known


def _of_suffix(endings: list[str]) -> Format:
    for ending in endings:
        for known in all_formats().values():
            if ending in known.suffixes:
                return known
    found = endings[-1][:20]
    raise FormatError(f"the name needs to end in {suffixes(written=True)}, not {found!r}; or say which by format")


def _listed(names: list[str], last: str) -> str:
    return last.join([*([", ".join(names[:-1])] if len(names) > 1 else []), *names[-1:]])
