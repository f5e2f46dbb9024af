"""The rig of a glTF file: the bind frames of its joints, and which joint moves which vertex.

A file has two poses. In one the skin was bound (the inverse of the inverse bind matrices); in the other the nodes
rest, which may be any frame of an animation. People are read in the bind pose, upright and in metres, with the 55
joints of SMPL-X; everything else in the rest pose, with its own joints. Either way vertices move as in glTF 2.0
(3.7.3.3); joints outside the map keep their bind pose under their parents.
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

_SAID = 3  # matched joints up to which names are not trusted


@dataclass(frozen=True, eq=False)
class Rig:
    """A skeleton for the shown meshes of a file."""

    skeleton: Skeleton
    joint: NDArray[np.intp]  # [N] the joint that moves a node; -1 for a node that moves nothing
    _before: F64  # [N, 4, 4] bind space of the avatar from a node's own space
    map: RigMap | None
    """Map of node indices; None for anything but a person with all needed joints."""
    why: str
    """Why there is no map, in one line."""
    guessed: bool = False
    """Whether the map was guessed from the joints' positions."""

    def place(self, nodes: NDArray[np.integer], inverse_bind: F64) -> F64:
        """Return [K, 4, 4] bind space from stored points of the ``nodes`` [K] with ``inverse_bind`` [K, 4, 4]."""
        return np.asarray(self._before[nodes] @ inverse_bind)


def rig_of(
    container: Container,
    graph: Graph,
    skins: Sequence[int],  # used skins, the one with the most vertices first
    rigid: Sequence[int],  # nodes of meshes without a skin
    given: Mapping[str, int | None],  # SMPL-X joint -> node, from the file or the user
    reference: F64,  # [55, 3] joints of a body in the T-pose, metres
    scale: float = 1.0,  # times the size by the file's nodes
    own_joints: bool = False,  # keep the joints, without a map
    holds: NDArray[np.bool_] | None = None,  # [N] nodes that move vertices
) -> Rig:
    """Return the rig of a file. Raises FormatError if it cannot be used."""
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
    """Return the names, "" outside the first skeleton if another is a whole person too: only one person is driven."""
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
    """Return SMPL-X joint -> node for a skeleton that stands like a person."""
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
    """Return a rig with its own joints, in its rest pose."""
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
