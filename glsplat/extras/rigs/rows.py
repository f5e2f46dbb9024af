"""Formats of the registry: glTF and VRM of triangles, beside glTF of splats."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from glsplat.errors import FormatError
from glsplat.formats.format import Format, Opened
from glsplat.formats.gltf.container import read_container
from glsplat.formats.gltf.splats import has_splats, splats_in
from glsplat.io.files import Source
from glsplat.meshes import RiggedMesh
from glsplat.optional import missing, plugin
from glsplat.scene import Content


def add_formats(formats: dict[str, Format]) -> None:
    """Make the formats of glTF read and write meshes, too."""
    for name in ("glb", "gltf"):
        row = formats[name]
        save_mesh = partial(_save_mesh, embedded=name == "gltf")
        formats[name] = replace(row, title=f"{row.title} or triangles", load=_read, save_mesh=save_mesh)


def _read(start: Opened) -> Content:
    container = read_container(start.file, start.size, start.folder)
    if has_splats(container.gltf):
        return splats_in(container)
    reader = plugin("rigs.meshes.reader")  # not at the top, as images need OpenCV
    if reader is None:
        raise FormatError(missing("formats", "a mesh's texture"))
    mesh: RiggedMesh = reader.mesh_of(container, Path(start.name).name)
    return mesh


def _save_mesh(mesh: RiggedMesh, target: Source, *, embedded: bool) -> None:
    from glsplat.extras.rigs.meshes.write import save_gltf_mesh  # not at the top, as images need OpenCV

    save_gltf_mesh(mesh, target, embedded=embedded)
