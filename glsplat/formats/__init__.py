"""Readers and writers of splat files. ``load`` looks at the content, ``save`` at the suffix.

==========================  ======  ======  ============================================================
format                      read    write   holds
==========================  ======  ======  ============================================================
3DGS PLY (.ply)             yes     yes     splats, SH degree 0 to 3
.splat (32 bytes a splat)   yes     yes     splats, 8-bit colour and rotation
glTF (.glb, .gltf)          yes     yes     splats (KHR_gaussian_splatting), avatars (with a skin)
==========================  ======  ======  ============================================================
"""

from __future__ import annotations

from typing import BinaryIO

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.files import Source, checked, folder_of, naming, open_regular, sampled, suffix_of
from glsplat.formats.gltf import load_gltf, read_gltf, save_gltf
from glsplat.formats.ply import load_ply, read_ply, save_ply
from glsplat.formats.splat import load_splat, looks_like_splat, read_splat, save_splat
from glsplat.splats import Splats

__all__ = ["load", "load_gltf", "load_ply", "load_splat", "recognise", "save", "save_gltf", "save_ply", "save_splat"]

_READ = "3DGS PLY, glTF/GLB with KHR_gaussian_splatting, or .splat"
_FORMATS = ("ply", "splat", "glb", "gltf")
_FOREIGN = {
    b"\x1f\x8b": "gzip, perhaps .spz or .ply.gz",
    b"NGSP": ".spz",
    b"PK": "a ZIP archive, perhaps .sog",
}


def recognise(source: Source) -> str:
    """ "ply", "glb", "gltf" or "splat", by content; FormatError when it is none of them.

    The name helps only where the content does not tell: .splat files have no mark of their own.
    """
    with naming(source), open_regular(source) as (file, size):
        return _recognise(file, size, suffix_of(source) == ".splat")


def load(source: Source, *, strict: bool = False, format: str | None = None) -> Splats | Avatar:
    """Read a scene or an avatar from a path or from a file that is open in binary mode.

    The format is recognised by content, whatever the file's name, unless ``format`` says it: "ply", "splat", "glb" or
    "gltf". An open file is read from where it stands and stays open. With ``strict``, NaN and infinity are refused
    instead of kept. Raises FormatError, one line that names the file.

    >>> glsplat.save(glsplat.default_avatar(), "me.glb")
    >>> glsplat.load("me.glb")
    Avatar(40000 splats, 55 joints, 4 a splat)
    """
    with naming(source), open_regular(source) as (file, size):
        kind = _recognise(file, size, suffix_of(source) == ".splat") if format is None else _known(format)
        file.seek(0)
        if kind == "ply":
            return checked(read_ply(file, size), source, strict)
        if kind == "splat":
            return checked(read_splat(file, size), source, strict)
        scene = read_gltf(file, size, folder_of(source))
        checked(scene.splats if isinstance(scene, Avatar) else scene, source, strict)
        return scene


def save(scene: Splats | Avatar, target: Source, *, format: str | None = None) -> None:
    """Write ``scene`` in the format of the suffix, .ply, .splat, .glb or .gltf, or of ``format``, the same without dot.

    ``target`` is a path, or a file open in binary mode, which is written to from where it stands. At a path the new
    file is complete or, on any failure, the old one as it was; a link is followed, an old file keeps its mode. An
    avatar goes into glTF with its rig; into the other formats go its splats alone, in the zero pose. Raises
    FormatError for another suffix, and when the file cannot be written.

    >>> glsplat.save(glsplat.default_avatar().splats, "me.ply")
    >>> len(glsplat.load("me.ply"))
    40000
    """
    with naming(target):
        suffix = suffix_of(target)
        if format is not None:
            suffix = f".{_known(format)}"
        elif suffix[1:] not in _FORMATS:
            raise FormatError(
                f"the name needs to end in .ply, .splat, .glb or .gltf, not {suffix[:20]!r}; or say which by format="
            )
        if suffix in (".glb", ".gltf"):
            return save_gltf(scene, target, embedded=suffix == ".gltf")
        splats = scene.splats if isinstance(scene, Avatar) else scene
        return save_ply(splats, target) if suffix == ".ply" else save_splat(splats, target)


def _recognise(file: BinaryIO, size: int, named_splat: bool) -> str:
    head = file.read(512)
    if not head:
        if named_splat:  # no splats
            return "splat"
        raise FormatError(f"the file is empty; expected {_READ}")
    if head.startswith((b"ply\n", b"ply\r", b"ply ")):
        return "ply"
    if head.startswith(b"glTF"):
        return "glb"
    text = not any(byte < 32 and byte not in b"\t\n\r" for byte in head)  # else a number that begins like a brace
    if text and head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
        if b'"items"' in head and b'"asset"' not in head:
            raise FormatError(f"expected {_READ}, but this is a scene file; see glsplat.making.items.load_scene")
        return "gltf"
    if size % 32 == 0:
        data = sampled(file, 0, size)
        if looks_like_splat(data) or (named_splat and looks_like_splat(data, named=True)):
            return "splat"
    foreign = next((name for magic, name in _FOREIGN.items() if head.startswith(magic)), None)
    raise FormatError(f"expected {_READ}, but this is {foreign or 'none of them'}; convert it first")


def _known(format: str) -> str:
    kind = format.lower().removeprefix(".") if isinstance(format, str) else ""
    if kind not in _FORMATS:
        raise FormatError(f"format is one of {', '.join(_FORMATS)}, not {format!r:.40}")
    return kind
