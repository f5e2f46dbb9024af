"""The one door for files: whatever glsplat reads, by content."""

from __future__ import annotations

from glsplat.formats.format import opened
from glsplat.formats.registry import is_scene_file
from glsplat.io.files import Source
from glsplat.scene import Content, Scene
from glsplat.scenes.scene_file import read_item, read_scene

__all__ = ["load"]


def load(source: Source, *, strict: bool = False, format: str | None = None) -> Content | Scene:
    """Read splats, an avatar, a mesh or a scene file from a path or from a file that is open in binary mode.

    The kind is told by content, whatever the file's name, unless ``format`` says it, "ply" or another name in
    ``glsplat.formats.FORMATS``. Splats with a skin are an Avatar; a mesh of triangles (glTF, VRM, OBJ, a person in
    .npz) is a RiggedMesh, on one joint where nothing moves it; a scene file is a Scene, whose background and motions
    ``glsplat.scenes.load_scene`` has. An open file is read from where it stands and stays open. A level of detail that
    is broken is left out, which is logged. With ``strict`` it is refused, as are NaN and infinity, which are kept or
    mended otherwise. Raises FormatError, one line that names the file.

    >>> glsplat.save(glsplat.default_avatar(), "me.glb")
    >>> glsplat.load("me.glb")
    Avatar(40000 splats, 55 joints, 4 a splat, 52 shapes, 3 levels)
    """
    with opened(source, strict) as start:
        if format is None and is_scene_file(start):
            return read_scene(start, strict).scene
        return read_item(start, strict, format)
