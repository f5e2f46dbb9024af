"""glTF 2.0 with KHR_gaussian_splatting: static scenes, and avatars (splats with a skin, docs/conventions.md).

Read: the ratified attribute names (KHR_gaussian_splatting:ROTATION, :SCALE, :OPACITY, :SH_DEGREE_l_COEF_n) and the
older drafts' (_ROTATION, _SCALE, colour and opacity in COLOR_0). Written: the ratified ones as float32, so that a
round trip is exact, and a COLOR_0 for viewers that know no splats (fallback.py). The specification gives skinned
splats no meaning; ours is plain glTF skinning of the Gaussians, which a viewer that knows only the extension shows in
the zero pose.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import frozen
from glsplat.avatar import Avatar
from glsplat.errors import FormatError
from glsplat.formats.files import Source, checked, folder_of, naming, open_regular
from glsplat.formats.format import Format
from glsplat.formats.gltf.compressed import SPZ_EXTENSION, packed_splats, packed_view
from glsplat.formats.gltf.container import Container, Mesh, Node, Primitive, Scene, read_container
from glsplat.formats.gltf.fallback import UNLIT, unlit_material, write_fallback
from glsplat.formats.gltf.nodes import Instance, graph_of, instances
from glsplat.formats.gltf.output import Output
from glsplat.formats.gltf.rig import read_skeleton, read_skin, write_influences, write_skeleton
from glsplat.formats.transform import transformed
from glsplat.splats import SH_C0, Splats

__all__ = ["EXTENSION", "GLB", "GLTF", "load_gltf", "read_gltf", "save_gltf"]

EXTENSION = "KHR_gaussian_splatting"
_VERSION = 1  # of asset.extras.glsplat
_ANTIALIAS = "antialias"  # in it: Splats.antialias
_CONE = (
    "_VISIBILITY_CONE"  # Splats.cones; an attribute of an application's own starts with an underscore (glTF 2.0, 3.7.2)
)
_WEIGHTS = "skin_weights"  # in it: what Skin.lost and Skin.repaired were
# POSITION may be stored as integers by KHR_mesh_quantization, a material means nothing to splats; other extensions that
# change the data are refused
_KNOWN = {EXTENSION, SPZ_EXTENSION, "KHR_mesh_quantization", "KHR_materials_unlit"}
_INSTANCES = 64  # times the splats stored, that nodes may show them: a small file must not become a huge scene
_SH_NAMES = [(degree, n) for degree in range(4) for n in range(2 * degree + 1)]


def load_gltf(source: Source, *, strict: bool = False) -> Splats | Avatar:
    """Read a .glb or .gltf: an Avatar where the splats have a skin, else all splats of the scene in world space.

    Node transforms are applied, including the rotation of spherical harmonics (transform.py); a skinned primitive
    ignores its node's transform, as glTF says. ``Avatar.skeleton.rest`` holds the joints' global node transforms,
    ``inverse_bind`` the skin's matrices. Scales of the review draft of 2025, which were logarithms under today's
    names, are recognised by being mostly negative. Non-finite values are kept, or with ``strict`` refused.

    Raises FormatError: no glTF, no splats in it, an attribute missing, truncated or of another kind, a colour space
    other than display sRGB, splats compressed by anything but SPZ, or an external buffer outside the file's own folder.
    """
    with naming(source), open_regular(source) as (file, size):
        scene = read_gltf(file, size, folder_of(source))
        checked(scene.splats if isinstance(scene, Avatar) else scene, source, strict)
        return scene


def read_gltf(file: BinaryIO, size: int, folder: Path | None) -> Splats | Avatar:
    """The scene of an open file of ``size`` bytes, whose other buffers lie in ``folder``."""
    return _scene(read_container(file, size, folder))


def save_gltf(scene: Splats | Avatar, target: Source, *, embedded: bool | None = None) -> None:
    """Write a .glb, or where ``target`` ends in .gltf one JSON file with its buffer ``embedded``.

    Attributes are stored as float32 exactly as they are, joints as the smallest unsigned integer that fits: 56 bytes a
    splat, 12 for each further coefficient, and 8 for the points that other viewers show.
    Raises FormatError when ``target`` cannot be written or an avatar's metadata is not JSON.
    """
    out = Output()
    splats = scene.splats if isinstance(scene, Avatar) else scene
    attributes = {"POSITION": out.add(splats.means, "VEC3", bounds=True)}
    attributes[f"{EXTENSION}:ROTATION"] = out.add(np.roll(splats.quats, -1, axis=1), "VEC4")  # xyzw
    attributes[f"{EXTENSION}:SCALE"] = out.add(splats.scales, "VEC3")
    attributes[f"{EXTENSION}:OPACITY"] = out.add(splats.opacities[:, None], "SCALAR")
    for k, (degree, n) in enumerate(_SH_NAMES[: splats.sh.shape[1]]):
        attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}"] = out.add(splats.sh[:, k], "VEC3")
    if splats.cones is not None:
        attributes[_CONE] = out.add(splats.cones, "VEC4", normalized=True)
    attributes["COLOR_0"] = write_fallback(out, splats)
    gltf = out.gltf
    gltf.meshes = [
        Mesh(
            primitives=[
                Primitive(
                    attributes=attributes,
                    mode=0,
                    material=0,
                    extensions={EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
                )
            ]
        )
    ]
    gltf.materials = [unlit_material("splats")]
    gltf.nodes = [Node(name="splats", mesh=0)]
    gltf.scene, gltf.scenes = 0, [Scene(nodes=[0])]
    note: dict[str, Any] = {"version": _VERSION}
    if isinstance(scene, Avatar):
        write_influences(out, scene.skin, len(scene.skeleton), attributes)
        write_skeleton(out, scene.skeleton)
        note |= dict(scene.meta)
        if scene.skin.lost or scene.skin.repaired:
            note[_WEIGHTS] = {"lost": scene.skin.lost, "repaired": scene.skin.repaired}
    note.pop(_ANTIALIAS, None)  # the splats decide, whatever an avatar's metadata says
    if splats.antialias:
        note[_ANTIALIAS] = True
    gltf.extensions_used = [EXTENSION, UNLIT]
    out.note(note)
    out.write(target, embedded=embedded)


def _scene(container: Container) -> Splats | Avatar:
    gltf = container.gltf
    unknown = [name for name in gltf.extensions_required if name not in _KNOWN]
    if unknown:
        raise FormatError(f"needs the extension {unknown[0][:60]!r}, which is not supported; export without it")
    graph = graph_of(gltf)
    found = list(instances(gltf, graph.world, EXTENSION))
    if not found:
        raise FormatError(f"a glTF file, but none of its meshes has splats (a POINTS primitive with {EXTENSION})")
    skinned = [i for i in found if i.node.skin is not None and "JOINTS_0" in i.primitive.attributes]
    if skinned:
        if len(found) > 1:
            raise FormatError(f"an avatar has one splat primitive with a skin, found {len(found)} splat primitives")
        splats = _splats(container, skinned[0].primitive, skinned[0].name)
        skeleton = read_skeleton(container, skinned[0], graph)
        note = container.note()
        note.pop(_ANTIALIAS, None)
        stored = note.pop(_WEIGHTS, None)
        stored = stored if isinstance(stored, dict) else {}
        return Avatar(splats, skeleton, read_skin(container, skinned[0], len(skeleton), len(splats), stored), note)
    return _merged(container, found)


def _merged(container: Container, found: list[Instance]) -> Splats:
    read: dict[tuple[bool, int], Splats] = {}
    parts: list[Splats] = []
    for instance in found:
        view = packed_view(instance.primitive.extensions[EXTENSION], instance.name)
        key = (True, id(instance.primitive)) if view is None else (False, view)
        if key not in read:
            read[key] = _splats(container, instance.primitive, instance.name)
        parts.append(read[key])
    if sum(map(len, parts)) > _INSTANCES * sum(map(len, read.values())):
        raise FormatError(f"the nodes show the same splats more than {_INSTANCES} times; bake fewer copies")
    parts = [transformed(part, instance.matrix) for part, instance in zip(parts, found, strict=True)]
    if len(parts) == 1:
        return parts[0]
    cones = [p.cones for p in parts if p.cones is not None]
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
    )


def _splats(container: Container, primitive: Primitive, name: str) -> Splats:
    if primitive.mode != 0:
        raise FormatError(f"{name}: splats need a POINTS primitive (mode 0), not mode {primitive.mode}")
    _check_extension(primitive.extensions[EXTENSION], name)
    view = packed_view(primitive.extensions[EXTENSION], name)
    if view is not None:
        return packed_splats(container, primitive, view, name)
    attributes = {key.replace(f"{EXTENSION}:", "_", 1): index for key, index in primitive.attributes.items()}

    def read(key: str, *types: str) -> NDArray[np.float32] | None:
        return container.numbers(attributes[key], f"{name} {key}", types) if key in attributes else None

    means, quats, scales = read("POSITION", "VEC3"), read("_ROTATION", "VEC4"), read("_SCALE", "VEC3")
    opacities, dc = read("_OPACITY", "SCALAR"), read("_SH_DEGREE_0_COEF_0", "VEC3")
    color = read("COLOR_0", "VEC3", "VEC4") if opacities is None or dc is None else None
    if opacities is None and color is not None and color.shape[1] == 4:
        opacities = color[:, 3:]
    if dc is None and color is not None:
        dc = ((color[:, :3] - 0.5) / SH_C0).astype(np.float32)
    needed = {"POSITION": means, "ROTATION": quats, "SCALE": scales, "OPACITY": opacities, "SH_DEGREE_0_COEF_0": dc}
    if means is None or quats is None or scales is None or opacities is None or dc is None:
        missing = ", ".join(key for key, value in needed.items() if value is None)
        raise FormatError(f"{name}: splats need the attributes {missing}")
    sh = [dc]
    keys = [f"_SH_DEGREE_{degree}_COEF_{n}" for degree, n in _SH_NAMES[1:]]
    last = max((k for k, key in enumerate(keys) if key in attributes), default=-1)
    for key in keys[: ((3, 8, 15)[_SH_NAMES[last + 1][0] - 1] if last >= 0 else 0)]:  # all up to the highest degree
        coefficient = read(key, "VEC3")
        if coefficient is None:
            raise FormatError(f"{name}: incomplete spherical harmonics, {key[1:]} is missing")
        sh.append(coefficient)
    counts = {len(a) for a in (means, quats, scales, opacities, *sh)}
    if len(counts) > 1:
        raise FormatError(f"{name}: the attributes need one count, found {', '.join(map(str, sorted(counts)))}")
    if not _written_by_us(container) and _logarithmic(scales):
        with np.errstate(over="ignore"):
            scales = np.exp(scales)
    return Splats.create(
        means,
        np.roll(quats, 1, axis=1),
        scales,
        opacities,
        frozen(np.stack(sh, axis=1)),
        antialias=container.note().get(_ANTIALIAS) is True,
        cones=_cones(container, attributes[_CONE], len(means), name) if _CONE in attributes else None,
    )


def _cones(container: Container, index: int, count: int, name: str) -> NDArray[np.int8]:
    raw = container.read(index, f"{name} {_CONE}", ("VEC4",))
    if raw.dtype != np.int8 or len(raw) != count:
        raise FormatError(f"{name}: {_CONE} needs {count} elements of signed bytes, not {len(raw)} of {raw.dtype}")
    return np.ascontiguousarray(raw, np.int8)


def _logarithmic(scales: NDArray[np.float32]) -> bool:
    return len(scales) > 0 and int((scales < 0).sum()) * 2 > scales.size


def _check_extension(value: Any, name: str) -> None:
    extension = value if isinstance(value, dict) else {}
    space = extension.get("colorSpace", "srgb_rec709_display")  # drafts made it optional, and had other names for it
    if space not in ("srgb_rec709_display", "BT.709", "BT.709-sRGB", "BT.709-srgb"):
        raise FormatError(f"{name}: needs colorSpace srgb_rec709_display, not {str(space)[:40]!r}; convert the colours")


def _written_by_us(container: Container) -> bool:
    return "version" in container.note()


def _begins_json(head: bytes) -> bool:
    """An object's brace and a key, or the end: numbers of a .splat may look like text from end to end."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return text[:1] == b"{" and text[1:].lstrip()[:1] in (b'"', b"}", b"")


_TITLE = f"glTF/GLB with {EXTENSION}"

GLB = Format(
    name="glb",
    title=_TITLE,
    suffixes=(".glb",),
    sniff=lambda start: start.head.startswith(b"glTF"),
    load=read_gltf,
    save=lambda scene, target: save_gltf(scene, target, embedded=False),
    rigs=True,
    cones=True,
)

GLTF = Format(
    name="gltf",
    title=_TITLE,
    suffixes=(".gltf",),
    sniff=lambda start: start.text and _begins_json(start.head),  # else it is a number of a .splat like a brace
    load=read_gltf,
    save=lambda scene, target: save_gltf(scene, target, embedded=True),
    rigs=True,
    cones=True,
)
