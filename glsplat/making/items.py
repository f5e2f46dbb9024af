"""What an item of a scene may show, read from a file: splats and avatars, and meshes, rigged or standing."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats import load
from glsplat.formats.files import naming, open_regular, path_of
from glsplat.formats.npz import array_names
from glsplat.formats.scene_file import SceneFile, load_scene_file, looks_like_scene_file
from glsplat.meshes import MeshPart, RiggedMesh, standing
from glsplat.motion.kinds import is_motion
from glsplat.scene import Content

__all__ = ["is_scene", "load_item", "load_scene"]


def load_scene(path: str | bytes | os.PathLike[Any], *, strict: bool = False) -> SceneFile:
    """A scene file with all it names; any other file is a scene of one. Raises FormatError naming the file."""
    path = Path(path_of(path))
    if is_scene(path):
        return load_scene_file(path, strict=strict, read=load_item)
    file = SceneFile.of(load_item(path, strict))
    file.sources = [(file.scene.items[0], path)]
    return file


def is_scene(path: str | Path) -> bool:
    """Whether a file is a scene file, by its beginning."""
    with naming(path), open_regular(path) as (file, _):
        return looks_like_scene_file(file.read(65536))


def load_item(path: str | bytes | os.PathLike[Any], strict: bool = False) -> Content:
    """Splats or an Avatar (``glsplat.load``), or a mesh: glTF without splats, OBJ, or a person archive (.npz).

    A glTF or VRM with skinned triangles gives all that its rig moves, a person on SMPL-X's joints
    (``read_gltf_person``). All other meshes stand: one joint, in the place the file's nodes give them. Raises
    FormatError naming the file.
    """
    path = Path(path_of(path))
    suffix = path.suffix.lower()
    if is_motion(path):
        raise FormatError(f"{path}: a motion, which shows nothing; give it to render, preview or replay as --motion")
    if suffix == ".obj":
        return _read_obj(path)
    if suffix == ".npz":
        return _read_npz(path)
    with naming(path), open_regular(path) as (file, size):
        head = file.read(20)
        if head.startswith(b"glTF") and len(head) == 20:
            text = file.read(min(struct.unpack("<I", head[12:16])[0], size))
        elif suffix == ".gltf":
            text = head + file.read()
        else:
            text = b"KHR_gaussian_splatting"  # no glTF: whatever load() makes of it
    if b"KHR_gaussian_splatting" in text:
        return load(path, strict=strict)
    from glsplat.making.gltf.reader import read_gltf_mesh  # here: images need OpenCV

    return read_gltf_mesh(path, strict=strict)


def _read_obj(path: Path) -> RiggedMesh:
    from glsplat.making.obj import flat, parse_obj, textures_of

    with naming(path):
        with open_regular(path) as (file, _):
            text = file.read().decode("utf-8", "replace")
        try:
            obj = parse_obj(text)
        except (ValueError, IndexError) as error:
            raise FormatError(f"not a usable OBJ ({str(error)[:80]})") from None
        textures: dict[str, tuple[NDArray[np.uint8], bool]] = {}
        for name, texture, mapped in textures_of(path, obj.library):
            if name in obj.names and (mapped or name not in textures or not textures[name][1]):
                textures[name] = texture, mapped
        parts = tuple(
            MeshPart(
                name or path.stem, obj.faces[mine], obj.uv[mine], textures[name][0] if name in textures else flat()
            )
            for index, name in enumerate(obj.names)
            if (mine := obj.material == index).any()
        )
        return standing(obj.vertices, parts, path.name)


def _read_npz(path: Path) -> RiggedMesh:
    from glsplat.making.people import read_person
    from glsplat.making.scans import read_body

    with naming(path), open_regular(path) as (file, _):
        body = "v_template" in array_names(file)
    return read_body(path) if body else read_person(path)
