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

from pathlib import Path

from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.files import naming, open_regular
from glsplat.formats.gltf import load_gltf, save_gltf
from glsplat.formats.ply import load_ply, save_ply
from glsplat.formats.splat import load_splat, looks_like_splat, save_splat
from glsplat.splats import Splats

__all__ = ["load", "load_gltf", "load_ply", "load_splat", "recognise", "save", "save_gltf", "save_ply", "save_splat"]

_READ = "3DGS PLY, glTF/GLB with KHR_gaussian_splatting, or .splat"
_FOREIGN = {
    b"\x1f\x8b": "gzip, perhaps .spz or .ply.gz",
    b"NGSP": ".spz",
    b"PK": "a ZIP archive, perhaps .sog",
}


def recognise(path: str | Path) -> str:
    """ "ply", "glb", "gltf" or "splat", by content; FormatError when it is none of them."""
    with naming(path), open_regular(path) as (file, size):
        head = file.read(512)
        if not head:
            raise FormatError(f"the file is empty; expected {_READ}")
        if head.startswith((b"ply\n", b"ply\r", b"ply ")):
            return "ply"
        if head.startswith(b"glTF"):
            return "glb"
        if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{"):
            return "gltf"
        foreign = next((name for magic, name in _FOREIGN.items() if head.startswith(magic)), None)
        if foreign is None and size % 32 == 0:
            file.seek(0)
            if looks_like_splat(file.read()):
                return "splat"
        raise FormatError(f"expected {_READ}, but this is {foreign or 'none of them'}; convert it first")


def load(path: str | Path, *, strict: bool = False) -> Splats | Avatar:
    """Read a scene or an avatar; the format is recognised by content, whatever the file's name.

    With ``strict``, NaN and infinity are refused instead of kept. Raises FormatError, one line that names the file.

    >>> glsplat.save(glsplat.default_avatar(), "me.glb")
    >>> glsplat.load("me.glb")
    Avatar(40000 splats, 55 joints, 4 a splat)
    """
    kind = recognise(path)
    if kind == "ply":
        return load_ply(path, strict=strict)
    if kind == "splat":
        return load_splat(path, strict=strict)
    return load_gltf(path, strict=strict)


def save(scene: Splats | Avatar, path: str | Path) -> None:
    """Write ``scene`` in the format of the suffix: .ply, .splat, .glb or .gltf.

    An avatar goes into glTF with its rig; into the other formats go its splats alone, in the zero pose. Raises
    FormatError for another suffix, and when the file cannot be written.

    >>> glsplat.save(glsplat.default_avatar().splats, "me.ply")
    >>> len(glsplat.load("me.ply"))
    40000
    """
    suffix = Path(path).suffix.lower()
    if suffix in (".glb", ".gltf"):
        return save_gltf(scene, path)
    splats = scene.splats if isinstance(scene, Avatar) else scene
    if suffix == ".ply":
        return save_ply(splats, path)
    if suffix == ".splat":
        return save_splat(splats, path)
    raise FormatError(f"{path}: the name needs to end in .ply, .splat, .glb or .gltf, not {suffix[:20]!r}")
