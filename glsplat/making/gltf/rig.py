"""The rig of a glTF file: where its joints were when the skin was bound, and which joint moves which vertex.

A file has two poses. In one the skin was bound (the inverse of the inverse bind matrices); in the other the nodes
rest, which may be any frame of an animation. People are taken as they were bound, upright and in metres, with the 55
joints of SMPL-X (skinning/rigs); everything else as the nodes rest, with its own joints. Either way a vertex moves as
glTF 2.0 (3.7.3.3) has it: joints that are no part of the map stay as they were bound under the one they hang from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.nodes import Graph
from glsplat.skinning.rigs.humanoid import humanoid, upright
from glsplat.skinning.rigs.match import RigMap, match_rig
from glsplat.skinning.rigs.shape import match_shape
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

__all__ = ["Rig", "inverse_binds", "rig_of"]

F64 = NDArray[np.float64]

_SAID = 3  # joints; with no more than that, names say nothing


@dataclass(frozen=True, eq=False)
class Rig:
    """A skeleton for what a file shows."""

    skeleton: Skeleton
    joint: NDArray[np.intp]  # [N] the joint that a node moves with; -1 for a node that moves nothing
    _before: F64  # [N, 4, 4] bind space of the avatar from a node's own space
    map: RigMap | None
    """Of node indices; None for what is no person, or one who lacks too much."""
    why: str
    """Why there is no map, in one line."""
    guessed: bool = False
    """No name said so: the map is by where the joints are."""

    def place(self, nodes: NDArray[np.integer], inverse_bind: F64) -> F64:
        """[K, 4, 4] where points bound to each of the ``nodes`` [K] by ``inverse_bind`` [K, 4, 4] are when bound."""
        return np.asarray(self._before[nodes] @ inverse_bind)


def inverse_binds(container: Container, skin: int) -> F64:
    """[J, 4, 4] inverse bind matrices of a skin; identities where the file has none (glTF 2.0, 5.28)."""
    joints, accessor = (found := item(container.gltf.skins, skin, "skin")).joints, found.inverse_bind_matrices
    if not joints or len(set(joints)) != len(joints):
        raise FormatError(f"a skin needs distinct joint nodes, found {len(set(joints))} distinct among {len(joints)}")
    for node in joints:
        item(container.gltf.nodes, node, "joint node")
    if accessor is None:
        return np.tile(np.eye(4), (len(joints), 1, 1))
    matrices = container.numbers(accessor, "inverseBindMatrices", ("MAT4",))
    if len(matrices) < len(joints):
        raise FormatError(f"a skin of {len(joints)} joints has only {len(matrices)} inverse bind matrices")
    return matrices[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def rig_of(
    container: Container,
    graph: Graph,
    skins: Sequence[int],  # those that are used, the one with the most vertices first
    rigid: Sequence[int],  # nodes that show meshes without a skin
    given: Mapping[str, int | None],  # SMPL-X joint -> node, as the file or the user says
    reference: F64,  # [55, 3] joints of a body in the T-pose, metres
    scale: float = 1.0,  # times what the file's nodes make of it
    own_joints: bool = False,  # no map is looked for
    holds: NDArray[np.bool_] | None = None,  # [N] nodes that move vertices
) -> Rig:
    """The rig of a file. Raises FormatError for one that cannot be used."""
    try:
        with np.errstate(all="ignore"):
            bound = _bound(container, graph, skins)
            if own_joints:
                return _thing(container, graph, bound, skins, rigid, scale, "")
            names = _candidates(container, skins, rigid, given)
            if not given:
                names = _one_person(container, graph, skins, names, bound.frames[:, :3, 3])
            why = "no joint has a name that says what it is"
            try:
                found = match_rig(names, graph.parents, bound.frames[:, :3, 3], given, holds)
                if found.joints:
                    why = f"no joint for {', '.join(found.missing)}"
                guess = {} if given or len(found) > _SAID else _by_shape(container, graph, bound, skins)
                if guess:
                    found = match_rig([""] * len(names), graph.parents, bound.frames[:, :3, 3], guess)
                if not found.missing:
                    return replace(_person(graph, bound, found, reference, scale), guessed=bool(guess))
            except PoseError as error:
                if given:
                    raise
                why = str(error)
            return _thing(container, graph, bound, skins, rigid, scale, why)
    except (PoseError, np.linalg.LinAlgError) as error:
        raise FormatError(f"the skin is not a usable rig: {error}") from None


def _one_person(container: Container, graph: Graph, skins: Sequence[int], names: list[str], points: F64) -> list[str]:
    """The names, but of whole skeletons beside the first: of two people one is driven, not some joints of each."""
    joints = {node for skin in skins for node in container.gltf.skins[skin].joints}
    tops: dict[int, int] = {}
    for node in graph.order:  # parents come before children
        above = int(graph.parents[node])
        tops[node] = tops[above] if above in joints or tops.get(above, above) != above else node
    groups = [{tops[node] for node in container.gltf.skins[skin].joints} for skin in skins]
    first = groups[0] if groups else set()
    for group in groups:
        first = first | group if first & group else first
    others = {top for group in groups for top in group} - first
    if not others:
        return names
    mine, theirs = (
        [name if tops[node] in which and node in joints else "" for node, name in enumerate(names)]
        for which in (first, others)
    )
    whole = all(not match_rig(some, graph.parents, points).missing for some in (mine, theirs))
    return mine if whole else names


def _by_shape(container: Container, graph: Graph, bound: _Bound, skins: Sequence[int]) -> dict[str, int]:
    """SMPL-X joint -> node, of a skeleton that stands like a person."""
    may = np.zeros(len(container.gltf.nodes), bool)
    for skin in skins:
        may[container.gltf.skins[skin].joints] = True
    return match_shape(graph.parents, bound.frames[:, :3, 3] @ bound.shown[:3, :3].T, may)


@dataclass(frozen=True, eq=False)
class _Bound:
    frames: F64  # [N, 4, 4] of all nodes, in the space in which the first skin's vertices are stored
    shown: F64  # [4, 4] the world from that space, as most joints have it


def _bound(container: Container, graph: Graph, skins: Sequence[int]) -> _Bound:
    """Where all nodes were when the first skin was bound; without skins, where they rest."""
    world = graph.world
    if not skins:
        return _Bound(world, np.eye(4))
    frames, shown = np.full_like(world, np.nan), np.eye(4)
    for place, skin in enumerate(skins):
        joints = container.gltf.skins[skin].joints
        inverse = inverse_binds(container, skin)
        known = [k for k, node in enumerate(joints) if np.isfinite(frames[node]).all()]
        to_first = np.eye(4)
        if place and known:  # another skin may be stored in another space; joints that both have tell which
            to_first = frames[joints[known[0]]] @ inverse[known[0]]
        elif place:
            to_first = np.linalg.solve(shown, world[joints[0]] @ inverse[0])
        for k, node in enumerate(joints):
            if not np.isfinite(frames[node]).all():
                frames[node] = to_first @ np.linalg.inv(inverse[k])
        if not place:
            shown = _usual(world[joints] @ inverse)
    for node in graph.order:  # parents first: what no skin knows hangs where it rests
        if not np.isfinite(frames[node]).all():
            parent = int(graph.parents[node])
            anchored = parent >= 0 and np.isfinite(frames[parent]).all()
            above = frames[parent] @ np.linalg.inv(world[parent]) if anchored else np.linalg.inv(shown)
            frames[node] = above @ world[node]
    return _Bound(frames, shown)


def _usual(placed: F64) -> F64:
    """[4, 4] the one of [J, 4, 4] that is nearest to all: joints that hold nothing may be bound to anything."""
    some = placed[:: max(1, len(placed) // 200)].reshape(-1, 16)
    apart = np.abs(some[:, None] - some[None]).sum(axis=(1, 2))
    return some[int(apart.argmin())].reshape(4, 4)


def _candidates(
    container: Container, skins: Sequence[int], rigid: Sequence[int], given: Mapping[str, int | None]
) -> list[str]:
    """Names of the nodes that may be joints; "" for all others: a mesh called "Head" is none."""
    gltf = container.gltf
    may = {node for skin in skins for node in gltf.skins[skin].joints} | {
        node for node in given.values() if node is not None
    }
    if not skins:  # a doll of rigid parts: the nodes themselves are its joints
        may |= set(range(len(gltf.nodes)))
    return [node.name or "" if index in may else "" for index, node in enumerate(gltf.nodes)]


def _person(graph: Graph, bound: _Bound, found: RigMap, reference: F64, scale: float) -> Rig:
    nodes = list(found.joints.values())
    sizes = [np.cbrt(np.abs(np.linalg.det(frames[nodes, :3, :3]))) for frames in (graph.world, bound.frames)]
    size = scale * float(np.median(sizes[0] / sizes[1]))
    turn = np.eye(4)
    turn[:3, :3] = size * upright(found, bound.frames[:, :3, 3])
    person = humanoid(found, graph.parents, bound.frames[:, :3, 3] @ turn[:3, :3].T, reference)
    rest = np.tile(np.eye(4), (len(JOINT_NAMES), 1, 1))
    rest[:, :3, 3] = person.joints
    skeleton = Skeleton(JOINT_NAMES, PARENTS, rest, np.linalg.inv(person.frames))
    return Rig(skeleton, person.of, turn @ bound.frames, found, "")


def _thing(
    container: Container,
    graph: Graph,
    bound: _Bound,
    skins: Sequence[int],
    rigid: Sequence[int],
    scale: float,
    why: str,
) -> Rig:
    """With its own joints, as it rests."""
    gltf = container.gltf
    used = dict.fromkeys([node for skin in skins for node in gltf.skins[skin].joints])
    used |= dict.fromkeys(rigid)
    nodes = list(used)
    if len(nodes) > 1 << 16:
        raise FormatError(f"a rig needs at most 65536 joints, found {len(nodes)}")
    joint = np.full(len(gltf.nodes), -1, np.intp)
    joint[nodes] = np.arange(len(nodes))
    parents = np.full(len(nodes), -1, np.int32)
    for j, node in enumerate(nodes):
        at = int(graph.parents[node])
        while at >= 0 and joint[at] < 0:
            at = int(graph.parents[at])
        parents[j] = joint[at] if at >= 0 else -1
    sized = np.diag([scale, scale, scale, 1.0])
    rest, turn = sized @ graph.world[nodes], sized @ bound.shown
    names: dict[str, None] = {}
    for j, node in enumerate(nodes):
        name = gltf.nodes[node].name or f"joint_{j}"
        names[name if name not in names else f"{name}_{j}"] = None
    before = turn @ bound.frames
    return Rig(Skeleton(tuple(names), parents, rest, np.linalg.inv(before[nodes])), joint, before, None, why)
