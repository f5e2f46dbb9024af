"""glTF 2.0 with KHR_gaussian_splatting: static scenes, and avatars (splats with a skin, docs/conventions.md).

Primitives are in primitive.py, coarser levels of detail in levels.py. The specification does not define skinned splats;
ours are plain glTF skinning of the Gaussians, which a viewer of the extension shows in the zero pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from glsplat.arrays import frozen
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats.format import Format, Opened
from glsplat.formats.gltf import rig
from glsplat.formats.gltf.container import Container, read_container
from glsplat.formats.gltf.levels import finest_of, read_levels, write_levels
from glsplat.formats.gltf.morphs import QUANTIZATION, shapes_of, write_shapes
from glsplat.formats.gltf.nodes import Graph, Instance, graph_of, instances
from glsplat.formats.gltf.output import UNLIT, Output, unlit_material
from glsplat.formats.gltf.primitive import (
    ANTIALIAS,
    COLOUR,
    EXTENSION,
    SPZ_EXTENSION,
    colour_note,
    packed_view,
    read_splats,
    write_splats,
)
from glsplat.formats.gltf.schema import Gltf, Mesh, Node, Scene
from glsplat.formats.transform import transformed
from glsplat.io.files import Source
from glsplat.light.surface import Surface
from glsplat.optional import plugin
from glsplat.splats import Splats

_VERSION = 1  # of asset.extras.glsplat
# POSITION may be stored as integers by KHR_mesh_quantization, a material means nothing to splats, levels of detail are
# more of the same; other extensions that change the data are refused
_KNOWN = {EXTENSION, SPZ_EXTENSION, QUANTIZATION, "KHR_materials_unlit", "MSFT_lod"}
_MAX_INSTANCES = 64  # shown splats per stored one: a small file must not become a huge scene


def read_gltf(start: Opened) -> Splats | Avatar:
    """Read an open .glb or .gltf: an Avatar where the splats have a skin, else all splats of the scene in world space.

    Node transforms are applied, including the rotation of spherical harmonics (transform.py); a skinned primitive
    ignores its node's transform, as glTF says. ``Avatar.skeleton.rest`` holds the joints' global node transforms,
    ``inverse_bind`` the skin's matrices. Scales of the review draft of 2025, which were logarithms under today's
    names, are recognised by being mostly negative. Non-finite values are kept. Non-finite skin weights, and levels of
    detail that cannot be used, are left out, which is logged, or where ``start`` is strict refused.

    Raises FormatError: no glTF, no splats in it, an attribute missing, truncated or of another kind, a colour space
    other than display sRGB, splats compressed by anything but SPZ, or an external buffer outside the file's own folder.
    """
    return splats_in(read_container(start.file, start.size, start.folder))


def has_splats(gltf: Gltf) -> bool:
    """Return whether the file names the extension, even if none of its meshes uses it."""
    named = (gltf.extensions_used, gltf.extensions_required)
    return any(EXTENSION in names for names in (*named, *(p.extensions for m in gltf.meshes for p in m.primitives)))


def save_gltf(scene: Splats | Avatar, target: Source, *, embedded: bool | None = None) -> None:
    """Write a .glb, or where ``target`` ends in .gltf one JSON file with its buffer ``embedded``.

    Attributes are stored exactly, as float32 or integers of the same value, joints as the smallest unsigned integer:
    56 bytes a splat, 12 for each further coefficient, and 8 for the points that other viewers show.
    Raises FormatError when ``target`` cannot be written or an avatar's metadata is not JSON.
    """
    out = Output()
    splats = splats_of(scene)
    primitive = write_splats(out, splats)
    gltf = out.gltf
    gltf.meshes = [Mesh(primitives=[primitive])]
    gltf.materials = [unlit_material("splats")]
    gltf.nodes = [Node(name="splats", mesh=0)]
    gltf.scene, gltf.scenes = 0, [Scene(nodes=[0])]
    note: dict[str, Any] = {"version": _VERSION}
    if isinstance(scene, Avatar):
        if scene.shapes is not None:
            write_shapes(out, scene.shapes, gltf.meshes[0], primitive)
        rig.write_influences(out, scene.skin, len(scene.skeleton), primitive.attributes)
        rig.write_skeleton(out, scene.skeleton)
        note |= dict(scene.meta)
        note |= rig.weights_note(scene.skin)
    note.pop(ANTIALIAS, None)  # the splats decide, whatever an avatar's metadata says
    note.pop(COLOUR, None)
    if splats.antialias:
        note[ANTIALIAS] = True
    note |= colour_note([splats, *(splats_of(level.content) for level in scene.levels)])
    gltf.extensions_used[:0] = [EXTENSION, UNLIT]
    write_levels(out, scene)
    out.note(note)
    out.write(target, embedded=embedded)


def splats_in(container: Container) -> Splats | Avatar:
    """Return the splats of a parsed file, as ``read_gltf`` does; repairs are logged or, if strict, refused."""
    gltf = container.gltf
    unknown = [name for name in gltf.extensions_required if name not in _KNOWN]
    if unknown:
        raise FormatError(f"needs the extension {unknown[0][:60]!r}, which is not supported; export without it")
    graph = graph_of(gltf)
    found = finest_of(list(instances(gltf, graph.world, EXTENSION)))
    if not found:
        hint = "" if plugin("rigs.rows") else "; triangles are read by glsplat.extras.rigs, which is not installed"
        raise FormatError(f"a glTF file, but none of its meshes has splats (a POINTS primitive with {EXTENSION}){hint}")
    skinned = [i for i in found if i.node.skin is not None and "JOINTS_0" in i.primitive.attributes]
    if not skinned:
        scene: Splats | Avatar = _merged(container, graph, found)
    elif len(found) > 1:
        raise FormatError(f"an avatar has one splat primitive with a skin, found {len(found)} splat primitives")
    else:
        splats = read_splats(container, skinned[0].primitive, skinned[0].name)
        skeleton = rig.read_skeleton(container, skinned[0], graph)
        note = container.note()
        note.pop(ANTIALIAS, None)
        note.pop(COLOUR, None)
        stored = note.pop(rig.SKIN_WEIGHTS, None)
        skin = rig.read_skin(container, skinned[0], len(skeleton), len(splats), stored)
        shapes = shapes_of(container, skinned[0], len(splats))
        scene = read_levels(container, graph, skinned, Avatar(splats, skeleton, skin, note, shapes=shapes))
    container.warn()
    return scene


def _merged(container: Container, graph: Graph, found: list[Instance]) -> Splats:
    read: dict[tuple[bool, int], Splats] = {}
    parts: list[Splats] = []
    for instance in found:
        view = packed_view(instance.primitive.extensions[EXTENSION], instance.name)
        key = (True, id(instance.primitive)) if view is None else (False, view)
        if key not in read:
            read[key] = read_splats(container, instance.primitive, instance.name)
        parts.append(read[key])
    if sum(map(len, parts)) > _MAX_INSTANCES * sum(map(len, read.values())):
        raise FormatError(f"the nodes show the same splats more than {_MAX_INSTANCES} times; bake fewer copies")
    parts[0] = read_levels(container, graph, found, parts[0])
    parts = [transformed(part, instance.matrix) for part, instance in zip(parts, found, strict=True)]
    if len(parts) == 1:
        return parts[0]
    cones = [p.cones for p in parts if p.cones is not None]
    kept = [p.cones_psnr for p in parts if p.cones_psnr is not None]
    coefficients = max(p.sh.shape[1] for p in parts)
    sh = [np.pad(p.sh, ((0, 0), (0, coefficients - p.sh.shape[1]), (0, 0))) for p in parts]
    return Splats(
        np.concatenate([p.means for p in parts]),
        np.concatenate([p.quats for p in parts]),
        np.concatenate([p.scales for p in parts]),
        np.concatenate([p.opacities for p in parts]),
        frozen(np.concatenate(sh)),
        all(p.antialias for p in parts),
        np.concatenate(cones) if len(cones) == len(parts) else None,
        min(kept) if len(kept) == len(parts) else None,
        surface=Surface.joined([p.surface for p in parts], list(map(len, parts))),
    )


def _begins_json(head: bytes) -> bool:
    """Return whether a brace and a key, or the end, begin it: a .splat may look like text from end to end."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return text[:1] == b"{" and text[1:].lstrip()[:1] in (b'"', b"}", b"")


GLB = Format(
    name="glb",
    title=f"glTF/GLB with {EXTENSION}",
    suffixes=(".glb",),
    sniff=lambda start: start.head.startswith(b"glTF"),
    load=read_gltf,
    save=lambda scene, target: save_gltf(scene, target, embedded=False),
    rigs=True,
    cones=True,
    levels=True,
    surfaces=True,
)
GLTF = replace(
    GLB,
    name="gltf",
    suffixes=(".gltf",),
    # a .splat may begin with a number like a brace; the meta.json of a SOG is no glTF
    sniff=lambda start: start.text and _begins_json(start.head) and not start.named("meta.json"),
    save=lambda scene, target: save_gltf(scene, target, embedded=True),
)


def add_formats(formats: dict[str, Format]) -> None:
    """Add glTF of splats to the registry."""
    formats |= {GLB.name: GLB, GLTF.name: GLTF}
