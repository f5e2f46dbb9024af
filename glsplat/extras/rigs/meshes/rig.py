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

from glsplat.arrays import F64
from glsplat.errors import FormatError, PoseError
from glsplat.extras.rigs.bound import Bound, bound_of, names_of_joints
from glsplat.extras.rigs.humanoid import seated
from glsplat.extras.rigs.match import RigMap, match_rig
from glsplat.extras.rigs.shape import match_shape
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Graph
from glsplat.formats.gltf.rig import MAX_JOINTS, joint_names, joint_parents
from glsplat.skinning.skeleton import Skeleton

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
            bound = bound_of(container, graph, skins)
            if own_joints:
                return _thing(container, graph, bound, skins, rigid, scale, "")
            names = names_of_joints(container, skins, given)
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


def _by_shape(container: Container, graph: Graph, bound: Bound, skins: Sequence[int]) -> dict[str, int]:
    """SMPL-X joint -> node, of a skeleton that stands like a person."""
    may = np.zeros(len(container.gltf.nodes), bool)
    for skin in skins:
        may[container.gltf.skins[skin].joints] = True
    return match_shape(graph.parents, bound.frames[:, :3, 3] @ bound.shown[:3, :3].T, may)


def _person(graph: Graph, bound: Bound, found: RigMap, reference: F64, scale: float) -> Rig:
    turn, skeleton, of = seated(found, graph.parents, bound.frames, graph.world, reference, scale)
    return Rig(skeleton, of, turn @ bound.frames, found, "")


def _thing(
    container: Container,
    graph: Graph,
    bound: Bound,
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
    if len(nodes) > MAX_JOINTS:
        raise FormatError(f"a rig needs at most {MAX_JOINTS} joints, found {len(nodes)}")
    joint = np.full(len(gltf.nodes), -1, np.intp)
    joint[nodes] = np.arange(len(nodes))
    sized = np.diag([scale, scale, scale, 1.0])
    rest, turn = sized @ graph.world[nodes], sized @ bound.shown
    before = turn @ bound.frames
    names, parents = joint_names(gltf, nodes), joint_parents(nodes, graph)
    return Rig(Skeleton(names, parents, rest, np.linalg.inv(before[nodes])), joint, before, None, why)
