"""Read avatars from LAM's export: a zip of Gaussians, each attached to a vertex of a skinned mesh."""

from __future__ import annotations

import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

from glsplat.arrays import F32, F64
from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, item, parse
from glsplat.formats.gltf.morphs import read_morphs, shape_names
from glsplat.formats.gltf.nodes import Graph, Instance, graph_of
from glsplat.formats.gltf.rig import read_skeleton, read_skin
from glsplat.formats.gltf.schema import Mesh
from glsplat.formats.registry import load_splats
from glsplat.io.files import naming
from glsplat.meshes import Morphs
from glsplat.skinning.expression import MOST_NAMES
from glsplat.skinning.shapes import Shapes
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.splats import Splats

Follow = Literal["weights", "head"]
FOLLOW_MODES: tuple[Follow, ...] = ("weights", "head")
"""A splat moves by the weights of its vertex, or, as in the public renderer, only by the joint called head."""

_MEMBERS, _MAX_MEMBER_BYTES = ("offset.ply", "skin.glb"), 1 << 29  # that are read, and may unpack to
_MAX_ENTRIES = 10_000  # of the zip's directory
_HEAD_JOINT = "head"


def is_lam_zip(path: str | Path) -> bool:
    """Return True for a zip with a member called offset.ply; False for anything else, readable or not."""
    try:
        with zipfile.ZipFile(path) as archive:
            return any(PurePosixPath(name).name == "offset.ply" for name in archive.namelist())
    except (OSError, ValueError, zipfile.BadZipFile):
        return False


def load_lam_zip(path: str | Path, follow: Follow = "weights") -> Avatar:
    """Read the avatar of a LAM export, in the rest pose of its mesh; morph targets become its shapes.

    Members, in the zip's root or in one folder: ``offset.ply``, a 3DGS PLY whose x y z is the offset of each splat
    from its mesh vertex and whose f_dc is plain RGB in [0, 1]; ``skin.glb``, the skinned mesh with morph targets.
    Splat i belongs to vertex i. ``vertex_order.json`` is not read: it is a drawing order of the vertices, roughly from
    low to high. Nor are ``animation.glb`` and ``bsData.json``, a recorded motion.

    ``follow`` "weights": splats move and turn with the joints of their vertices, so that neck and shoulders stay when
    the head turns. "head": all follow the joint called head, as in the public renderer (gaussian-splat-renderer-for-lam
    0.0.8): splats far from their vertices, above all hair, would be pulled apart where weights change. Morph targets
    move splats and do not bend them.

    Raises FormatError naming the zip and the member. Sizes in the directory are checked before anything is unpacked,
    and files are never named after the zip's own names.
    """
    try:
        with zipfile.ZipFile(path) as archive, tempfile.TemporaryDirectory(prefix="glsplat-") as folder:
            found = _checked_members(archive)
            for name, info in found.items():
                (Path(folder) / name).write_bytes(archive.read(info))
            try:
                return _avatar(Path(folder), Path(path), follow)
            except FormatError as error:
                raise FormatError(str(error).replace(f"{folder}/", "").replace(f"{folder}\\", "")) from None
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    except OSError as error:
        raise FormatError(f"{path}: cannot read the zip ({error.strerror or error})") from None
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, ValueError) as error:
        raise FormatError(f"{path}: a LAM export is a zip, but {' '.join(str(error).split())[:120]}") from None


def _checked_members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Return the members to read, after checks of their number, names and sizes."""
    entries = archive.infolist()
    if len(entries) > _MAX_ENTRIES:
        raise FormatError(f"a LAM export has a handful of members, this zip {len(entries)}")
    found: dict[str, zipfile.ZipInfo] = {}
    for info in entries:
        name = PurePosixPath(info.filename).name
        if info.is_dir() or name not in _MEMBERS or "__MACOSX" in info.filename:
            continue
        if name in found:
            raise FormatError(f"two members are called {name}; keep one avatar in a zip")
        if info.file_size > _MAX_MEMBER_BYTES:
            raise FormatError(f"{name} would unpack to {info.file_size >> 20} MiB, more than {_MAX_MEMBER_BYTES >> 20}")
        if info.flag_bits & 1:
            raise FormatError(f"{name} is encrypted; unpack the zip and pack it without a password")
        found[name] = info
    for name in _MEMBERS:
        if name not in found:
            inside = ", ".join(info.filename[:40] for info in entries[:6]) or "nothing"
            raise FormatError(f"a LAM export needs the member {name}; found {inside}")
    return found


def _avatar(folder: Path, source: Path, follow: Follow) -> Avatar:
    splats = splats_of(load_splats(folder / "offset.ply", format="ply"))
    vertices, skeleton, skin, morphs = _mesh(folder / "skin.glb", source)
    count, names = len(splats), skeleton.names
    if len(vertices) != count:
        raise FormatError(f"offset.ply has {count} splats, skin.glb {len(vertices)} vertices; each splat rides one")
    rgb = splats.sh[:, 0].astype(np.float64)
    usable = splats.finite()
    if usable.any():
        _check_offsets(splats.means[usable], rgb[usable], vertices)
    at = vertices + splats.means
    placed = Splats.create(at, splats.quats, splats.scales, splats.opacities, rgb=rgb)
    if follow == "head":
        if _HEAD_JOINT not in names:
            raise FormatError(f'skin.glb has no joint called "{_HEAD_JOINT}" that all splats could follow')
        skin = Skin.create(np.full((count, 1), names.index(_HEAD_JOINT)), np.ones((count, 1)), len(names), 1)
    else:
        skin = Skin.create(skin.joints, skin.weights, len(names))
    meta: dict[str, Any] = {
        "source": f"LAM, {source.name}",
        "body_model": f"{len(names)} joints of skin.glb",
        "licence": "as the picture and LAM's weights (CC BY-NC 4.0) allow",
    }
    return Avatar(placed, skeleton, skin, meta, shapes=_shapes(morphs, count))


def _shapes(morphs: Morphs, count: int) -> Shapes | None:
    """Return shapes that move splats with their vertices and keep their axes: the export has no triangles for them."""
    if not len(morphs) or len(morphs) > MOST_NAMES or not np.isfinite(morphs.offsets).all():
        return None
    targets = np.repeat(np.arange(len(morphs)), np.diff(morphs.starts))
    names = shape_names(morphs.names)
    return Shapes.create(names, count, splats=morphs.vertices, targets=targets, moves=morphs.offsets)


def _mesh(path: Path, source: Path) -> tuple[F64, Skeleton, Skin, Morphs]:
    """Return the skinned vertices [N, 3] that splats are attached to, with their rig."""
    with naming(path):
        container = parse(path.read_bytes(), path.parent)
        graph = graph_of(container.gltf)
        mesh, instance = _skinned(container, graph)
        vertices = container.numbers(instance.primitive.attributes["POSITION"], "POSITION", ("VEC3",))
        if not np.isfinite(vertices).all():
            raise FormatError("POSITION needs finite numbers, found NaN or infinity")
        skeleton = read_skeleton(container, instance, graph)
        skin = read_skin(container, instance, len(skeleton), len(vertices), {})
        morphs = read_morphs(container, mesh, instance.primitive)
        with naming(f"{source}: {path.name}"):  # the temporary path would mislead
            container.warn()
        return vertices.astype(np.float64), skeleton, skin, morphs


def _skinned(container: Container, graph: Graph) -> tuple[Mesh, Instance]:
    """Return the primitive with a skin; of several, the one with the most vertices."""
    gltf = container.gltf
    found: list[tuple[int, Mesh, Instance]] = []
    for number, node in enumerate(gltf.nodes):
        if node.mesh is None or node.skin is None:
            continue
        mesh = item(gltf.meshes, node.mesh, "mesh")
        for primitive in mesh.primitives:
            if primitive.mode == 4 and {"JOINTS_0", "POSITION"} <= primitive.attributes.keys():
                count = item(gltf.accessors, primitive.attributes["POSITION"], "accessor of POSITION").count
                where = graph.world[number]
                found.append((count, mesh, Instance(primitive, node, where, f"mesh {node.mesh}", number)))
    if not found:
        raise FormatError("splats ride triangles with a skin (JOINTS_0 and WEIGHTS_0), found none")
    _, mesh, instance = max(found, key=lambda entry: entry[0])
    return mesh, instance


def _check_offsets(offsets: F32, rgb: F64, vertices: F64) -> None:
    if rgb.min() < -0.02 or rgb.max() > 1.02:
        raise FormatError(
            f"offset.ply needs RGB in [0, 1] in f_dc, as LAM writes it, found {rgb.min():.2f} to {rgb.max():.2f}; "
            "for spherical harmonics and positions, bind the PLY to the mesh with --mesh"
        )
    typical = float(np.median(np.linalg.norm(offsets.astype(np.float64), axis=1)))
    extent = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if typical > 0.1 * extent:
        raise FormatError(
            f"offset.ply needs offsets from the mesh, found {typical:.3g} m in the median on a mesh of {extent:.3g} m; "
            "if these are positions, bind the PLY to the mesh with --mesh"
        )
