"""Read textured, rigged meshes from any maker's glTF 2.0 and VRM: people on SMPL-X's joints, all else as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.rigs.gltf import human_bones
from glsplat.extras.rigs.match import other_side
from glsplat.extras.rigs.meshes.left_out import TRIANGLES, LeftOut, apart, carried, nearest, refuse_packed, survey
from glsplat.extras.rigs.meshes.rig import Rig, faces_back, on_the_floor, rig_of
from glsplat.extras.rigs.meshes.surfaces import Faces, Materials, Surface, surface_of
from glsplat.formats.format import A_MOTION, opened
from glsplat.formats.gltf.container import Container, item, read_container
from glsplat.formats.gltf.nodes import Graph, Instance, graph_of, instances, only_moves
from glsplat.formats.gltf.rig import inverse_binds, read_influences, read_skeleton
from glsplat.meshes import MeshPart, RiggedMesh, standing
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_MOST = 1 << 25  # vertices and corners of triangles
_NO_SKIN = "a person needs triangles with a skin (JOINTS_0 and WEIGHTS_0), or parts named as a body's are; found none"
_SKELETONS = 256  # most skeletons of a file in which another person is sought
_KEPT = 8  # joints a vertex
_ALIKE = 1e-9  # of the largest number: matrices closer than that are equal


def read_gltf_person(
    path: str | Path,
    *,
    own_joints: bool = False,  # keep the file's skeleton, also of a person
    rig_map: Mapping[str, str | None] | None = None,  # SMPL-X joint -> name of a node; None: the rig has none
    scale: float = 1.0,
    strict: bool = False,
) -> RiggedMesh:
    """Read all skins of a .glb, .gltf or .vrm, and meshes under joints.

    Without a skin, a doll is read whose nodes are named as the parts of a body: these are its joints.

    A rig whose joints are recognised gets the 55 joints of SMPL-X; its zero pose is the T-pose and it stands on y = 0;
    ``meta["rig"]`` has the map. Any other rig keeps its joints, and its zero pose is the file's rest pose.
    ``meta["left_out"]`` lists what is not read. Weights, texture coordinates and colours that are not finite become
    0, (0, 0) and white and are logged, or with ``strict`` refused. Raises FormatError naming the file: nothing with a
    rig, compressed geometry, a texture that is no picture, points that are not finite.
    """
    with opened(path, strict) as start, np.errstate(all="ignore"):  # RiggedMesh refuses values that are not finite
        container = read_container(start.file, start.size, start.folder)
        graph = graph_of(container.gltf)
        shown = _shown(container, graph)
        if not shown:
            raise FormatError(_NO_SKIN)
        mesh = _rigged(container, graph, shown, Path(start.name).name, own_joints, rig_map or {}, scale)
        container.warn()
        return mesh


def mesh_of(container: Container, source: str) -> RiggedMesh:
    """Read a mesh as ``read_gltf_person``; without a skin, all that is shown stands on one joint at the origin.

    ``source`` is the file's name, without its folder.
    """
    with np.errstate(all="ignore"):
        graph = graph_of(container.gltf)
        shown = _shown(container, graph)
        if only_moves(container.gltf):
            raise FormatError(A_MOTION)
        if not shown:
            raise FormatError("a mesh needs triangles, this glTF has neither those nor splats (KHR_gaussian_splatting)")
        if any(_skinned(i) for i in shown):
            mesh = _rigged(container, graph, shown, source, False, {}, 1.0)
        else:
            whole = _Collected()
            materials: Materials = {}
            for instance in shown:
                surface = surface_of(container, instance, _weights(container, instance), materials)
                whole.add(surface, surface.points @ instance.matrix[:3, :3].T + instance.matrix[:3, 3])
            mesh = standing(np.concatenate(whole.points), tuple(whole.parts), source)
        container.warn()
        return mesh


def _shown(container: Container, graph: Graph) -> list[Instance]:
    """Return the shown triangles. Raises FormatError if nodes repeat meshes beyond ``_MOST`` vertices and corners."""
    found = [
        i
        for i in instances(container.gltf, graph.world)
        if i.primitive.mode in TRIANGLES and "POSITION" in i.primitive.attributes
    ]
    accessors = container.gltf.accessors
    used = [index for i in found for index in (i.primitive.attributes["POSITION"], i.primitive.indices)]
    total = sum(accessors[index].count for index in used if index is not None and index < len(accessors))
    if total > _MOST:
        raise FormatError(f"the nodes show {total} vertices and corners in all; {_MOST} are read at most")
    refuse_packed(found)
    return found


def _skinned(instance: Instance) -> bool:
    return instance.node.skin is not None and "JOINTS_0" in instance.primitive.attributes


def _weights(container: Container, instance: Instance) -> Sequence[float]:
    """Return the morph targets' weights: the node's, else the mesh's (glTF 2.0, 3.7.2.2)."""
    mesh = instance.node.mesh
    return instance.node.weights or (container.gltf.meshes[mesh].weights if mesh is not None else [])


def _rigged(
    container: Container,
    graph: Graph,
    shown: Sequence[Instance],
    source: str,
    own_joints: bool,
    rig_map: Mapping[str, str | None],
    scale: float,
    turned: Mapping[str, int | None] | None = None,  # the map after left and right were exchanged
    guessed: bool = False,  # whether that map was guessed from positions
) -> RiggedMesh:
    gltf = container.gltf
    node_of = {id(node): index for index, node in enumerate(gltf.nodes)}
    sizes: dict[int, int] = {}
    for instance in shown:
        if _skinned(instance):
            accessor = instance.primitive.attributes["POSITION"]
            count = gltf.accessors[accessor].count if accessor < len(gltf.accessors) else 0
            sizes[instance.node.skin or 0] = sizes.get(instance.node.skin or 0, 0) + count
    skins = sorted(sizes, key=lambda skin: (-sizes[skin], skin))
    for skin in skins:
        item(gltf.skins, skin, "skin")
    if skins:
        ready = read_skeleton(container, next(i for i in shown if i.node.skin == skins[0] and _skinned(i)), graph)
        if len(skins) == 1 and (container.note() or ready.names == JOINT_NAMES):  # our own files are read unchanged
            return _plain(container, shown, skins[0], ready, source)
    rigid = [node_of[id(i.node)] for i in shown if not _skinned(i)]
    given = _given(container, rig_map)
    known = {} if own_joints else turned or given
    holds = _holding(container, shown, rigid)
    rig = rig_of(container, graph, skins, rigid, known, scale, own_joints, holds)
    if not skins and rig.map is None:
        raise FormatError(_NO_SKIN)
    left = LeftOut()
    mapped = list(rig.map.joints.values()) if rig.map is not None else []
    several = len(skins) if mapped and 1 < len(skins) <= _SKELETONS else 0
    strangers = {skin for skin in skins[:several] if apart(graph, gltf.skins[skin].joints, mapped)}
    under = carried(graph, [*mapped, *(n for skin in skins if skin not in strangers for n in gltf.skins[skin].joints)])
    whole = _Collected()
    materials: Materials = {}
    morphed: set[int] = set()
    faces = Faces(container)
    for instance in shown:
        if _skinned(instance) and instance.node.skin in strangers:
            left.add("meshes of another skeleton are left out", 1, instance.node.name or instance.name)
            continue
        surface = surface_of(container, instance, _weights(container, instance), materials)
        node = node_of[id(instance.node)]
        on: int | None = node
        if mapped and not _skinned(instance) and not under[node]:
            placed = surface.points @ instance.matrix[:3, :3].T + instance.matrix[:3, 3]
            on = nearest(graph, placed, mapped)
        if on is None:
            left.add("meshes beside the person are left out", 1, instance.node.name or instance.name)
            continue
        points, moved, shares, linear = _bound(container, instance, node, on, surface, rig)
        still = faces.add(instance, node, whole.count, linear)
        whole.add(surface, points, moved, shares)
        if node not in morphed:  # all primitives of a mesh share their targets
            morphed.add(node)
            left.add("morph targets stay at their default weights", still)
    survey(container, list(instances(gltf, graph.world)), left)
    at, skeleton = np.concatenate(whole.points), rig.skeleton
    all_joints, all_weights = _wide(whole.joints), _wide(whole.weights)
    if rig.map is not None:
        skeleton, at = on_the_floor(skeleton, at, all_joints, all_weights, rig.map.joints)
        if not known and faces_back(skeleton, at, all_joints, all_weights, rig.map.joints):
            other = {other_side(name): node for name, node in rig.map.joints.items()}
            return _rigged(container, graph, shown, source, own_joints, rig_map, scale, other, rig.guessed)
    meta: dict[str, Any] = {"source": source} | container.note()
    meta.pop("version", None)
    names = [node.name or f"node {index}" for index, node in enumerate(gltf.nodes)]
    if rig.map is not None:
        meta["rig"] = {name: names[node] for name, node in rig.map.joints.items()}
        if guessed or rig.guessed:
            left.add("joints have no name that says what they are, and are told by where they are", len(rig.map))
        elif turned:
            left.add("person with left and right exchanged: corrected by the feet's direction")
    elif rig.why:
        meta["no_map"] = rig.why
    if left.counts:
        meta["left_out"] = left.lines()
    return RiggedMesh(at, skeleton, all_joints, all_weights, tuple(whole.parts), meta, faces.morphs())


def _holding(container: Container, shown: Sequence[Instance], rigid: Sequence[int]) -> NDArray[np.bool_]:
    """Return [N] whether a node moves vertices; vertices bound to the root for lack of a weight do not count."""
    gltf = container.gltf
    holds = np.zeros(len(gltf.nodes), bool)
    holds[list(rigid)] = True
    for instance in shown:
        if _skinned(instance):
            nodes = np.array(item(gltf.skins, instance.node.skin or 0, "skin").joints)
            count = gltf.accessors[instance.primitive.attributes["JOINTS_0"]].count
            ids, weights, rooted = _influences(container, instance, count, len(nodes))
            holds[nodes[ids[(weights > 0) & ~rooted[:, None]]]] = True
    return holds


def _wide(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return parts of different widths as [V, K], padded with zeros."""
    width = max(part.shape[1] for part in parts)
    return np.concatenate([np.pad(part, ((0, 0), (0, width - part.shape[1]))) for part in parts])


def _given(container: Container, rig_map: Mapping[str, str | None]) -> dict[str, int | None]:
    """Return the file's map, overridden by the user's, with node indices."""
    given: dict[str, int | None] = dict(human_bones(container.gltf))
    names = [node.name for node in container.gltf.nodes]
    for joint, name in rig_map.items():
        if joint not in JOINT_NAMES:
            raise FormatError(f'a rig map names joints of SMPL-X (left_hip, ...), not "{joint:.40}"')
        if name is not None and name not in names:
            raise FormatError(f'the rig map gives {joint} the node "{name:.40}", which the file does not have')
        given[joint] = None if name is None else names.index(name)
    return given


def _bound(
    container: Container, instance: Instance, node: int, on: int, surface: Surface, rig: Rig
) -> tuple[F64, NDArray[np.int64], F64, F64]:
    """Return bound points [V, 3], and joints and weights [V, K] of the rig; without a skin the joint is ``on``.

    The last value, [3, 3] or [V, 3, 3], turns offsets of the points.
    """
    points = np.column_stack([surface.points, np.ones(len(surface.points))])
    if not _skinned(instance):
        place = rig.place(np.array([node]), np.eye(4)[None])[0]
        joints = np.full((len(points), 1), rig.joint[on])
        return (points @ place.T)[:, :3], joints, np.ones((len(points), 1)), place[:3, :3]
    skin = instance.node.skin or 0
    nodes = np.array(container.gltf.skins[skin].joints)
    ids, weights, _ = _influences(container, instance, len(points), len(nodes))
    places = rig.place(nodes, inverse_binds(container, skin))
    used = np.unique(ids[weights > 0])
    if len(used) == 0:
        raise FormatError(f"{instance.name}: no vertex has a weight")
    first = places[used[0]]
    if np.abs(places[used] - first).max() <= _ALIKE * np.abs(places[used]).max():
        at, linear = points @ first.T, first[:3, :3]
    else:
        at, linear = np.zeros_like(points), np.einsum("vk,vkij->vij", weights, places[ids, :3, :3])
        for column in range(ids.shape[1]):
            at += weights[:, column, None] * np.einsum("vij,vj->vi", places[ids[:, column]], points)
    joints, shares = _merged(rig.joint[nodes][ids], weights)
    return at[:, :3], joints, shares, linear


def _influences(
    container: Container, instance: Instance, count: int, joints: int
) -> tuple[NDArray[np.int64], F64, NDArray[np.bool_]]:
    """Return indices into the skin's joints, weights [V, 4 or 8] that sum to one, and ``Influences.rooted`` [V]."""
    found, where = read_influences(container, instance, count), instance.name
    wide, shares = found.joints, found.weights.astype(np.float64)
    if wide.size and wide[shares > 0].max(initial=0) >= joints:
        raise FormatError(f"{where}: a vertex is bound to joint {wide[shares > 0].max()} of {joints}")
    if (shares < 0).any():
        raise FormatError(f"{where}: weights need numbers from 0 on")
    wide[shares <= 0] = 0
    shares[shares.sum(axis=1) <= 0, 0] = 1  # no weights: undefined in the specification; viewers use the first
    return wide, shares / shares.sum(axis=1, keepdims=True), found.rooted


def _merged(joints: NDArray[np.intp], weights: F64) -> tuple[NDArray[np.int64], F64]:
    """Merge repeated joints of a vertex and keep the eight heaviest, heaviest first."""
    order = np.argsort(joints, axis=1, kind="stable")
    ids, shares = np.take_along_axis(joints, order, 1), np.take_along_axis(weights, order, 1).copy()
    for column in range(ids.shape[1] - 1, 0, -1):  # add equal neighbours to the left one
        same = ids[:, column] == ids[:, column - 1]
        shares[same, column - 1] += shares[same, column]
        shares[same, column] = 0
    heaviest = np.argsort(-shares, axis=1, kind="stable")[:, :_KEPT]
    ids, shares = np.take_along_axis(ids, heaviest, 1), np.take_along_axis(shares, heaviest, 1)
    ids = np.where(shares > 0, ids, ids[:, :1])
    return ids.astype(np.int64), shares / shares.sum(axis=1, keepdims=True)


def _plain(container: Container, shown: Sequence[Instance], skin: int, skeleton: Skeleton, source: str) -> RiggedMesh:
    """Read a person who already has the joints of SMPL-X, with the stored points."""
    whole = _Collected()
    materials: Materials = {}
    faces = Faces(container)
    for instance in shown:
        if not _skinned(instance) or instance.node.skin != skin:
            continue
        faces.add(instance, instance.index, whole.count, np.eye(3))
        surface = surface_of(container, instance, _weights(container, instance), materials)
        ids, shares, _ = _influences(container, instance, len(surface.points), len(skeleton))
        more = ((0, 0), (0, _KEPT - ids.shape[1]))
        whole.add(surface, surface.points, np.pad(ids, more), np.pad(shares, more))
    meta = {"source": source} | container.note()
    meta.pop("version", None)
    points, joints = np.concatenate(whole.points), np.concatenate(whole.joints)
    weights = np.concatenate(whole.weights)
    return RiggedMesh(points, skeleton, joints, weights, tuple(whole.parts), meta, faces.morphs())


class _Collected:
    """Points, influences and parts of the surfaces read so far."""

    def __init__(self) -> None:
        self.points: list[F64] = []
        self.joints: list[NDArray[np.int64]] = []
        self.weights: list[F64] = []
        self.parts: list[MeshPart] = []
        self.count = 0

    def add(
        self, surface: Surface, points: F64, joints: NDArray[np.int64] | None = None, weights: F64 | None = None
    ) -> None:
        faces = (surface.faces + self.count).astype(np.int32)
        self.parts.append(MeshPart(surface.name, faces, surface.uv, surface.texture))
        self.points.append(points)
        if joints is not None and weights is not None:
            self.joints.append(joints)
            self.weights.append(weights)
        self.count += len(points)
