"""The rig of a glTF file: the bind frames of its joints, which joint moves which vertex, and the floor below a person.

A file has two poses. In one the skin was bound (the inverse of the inverse bind matrices); in the other the nodes
rest, which may be any frame of an animation. People are read in the bind pose, upright and in metres, with the 55
joints of SMPL-X; everything else in the rest pose, with its own joints. Either way vertices move as in glTF 2.0
(3.7.3.3); joints outside the map keep their bind pose under their parents.

A user's rig map is a JSON object, {"left_hip": "MyThigh_L", "jaw": null, ...}: SMPL-X joint -> name of a node, or none.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError, PoseError
from glsplat.extras.rigs.gltf import Bound, bound_of, names_of_joints
from glsplat.extras.rigs.humanoid import reference_joints, seated
from glsplat.extras.rigs.match import RigMap, match_rig
from glsplat.extras.rigs.shape import match_shape
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Graph
from glsplat.formats.gltf.rig import MAX_JOINTS, joint_names, joint_parents
from glsplat.io.files import naming, read_json
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

_SAID = 3  # matched joints up to which names are not trusted

_SOLE = 0.0165  # of the stature; height of the foot joint (the ball) above the floor, as on the reference body
_ANKLE = 0.045  # of the stature
_BALL = 0.7  # of the way from heel to tip
_CLEARLY = 2.0  # a shoe that reaches this many times as far behind the ankle as before it points backwards

_LARGEST = 1 << 20  # bytes


@dataclass(frozen=True, eq=False)
class Rig:
    """A skeleton for the shown meshes of a file."""

    skeleton: Skeleton
    joint: NDArray[np.intp]  # [N] the joint that moves a node; -1 for a node that moves nothing
    _before: F64  # [N, 4, 4] bind space of the avatar from a node's own space
    map: RigMap | None  # map of node indices; None for anything but a person with all needed joints
    why: str  # why there is no map, in one line
    guessed: bool = False  # whether the map was guessed from the joints' positions

    def place(self, nodes: NDArray[np.integer], inverse_bind: F64) -> F64:
        """Return [K, 4, 4] bind space from stored points of the ``nodes`` [K] with ``inverse_bind`` [K, 4, 4]."""
        return np.asarray(self._before[nodes] @ inverse_bind)


def rig_of(
    container: Container,
    graph: Graph,
    skins: Sequence[int],  # used skins, the one with the most vertices first
    rigid: Sequence[int],  # nodes of meshes without a skin
    given: Mapping[str, int | None],  # SMPL-X joint -> node, from the file or the user
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
                guess: dict[str, int] = {}
                if not given and len(found) <= _SAID:
                    may = np.zeros(len(container.gltf.nodes), bool)
                    may[[node for skin in skins for node in container.gltf.skins[skin].joints]] = True
                    guess = match_shape(graph.parents, bound.frames[:, :3, 3] @ bound.shown[:3, :3].T, may)
                if guess:
                    found = match_rig([""] * len(names), graph.parents, bound.frames[:, :3, 3], guess)
                if not found.missing:
                    turn, skeleton, of = seated(
                        found, graph.parents, bound.frames, graph.world, reference_joints(), scale
                    )
                    return Rig(skeleton, of, turn @ bound.frames, found, "", bool(guess))
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


_AT = {name: index for index, name in enumerate(JOINT_NAMES)}


def on_the_floor(
    skeleton: Skeleton,  # the 55 joints of SMPL-X, rest frames parallel to the world
    vertices: F64,  # [V, 3] as bound
    joints: NDArray[np.int64],  # [V, K]
    weights: F64,  # [V, K]
    known: Collection[str],  # joints that the rig has; all others were placed by the reference body
) -> tuple[Skeleton, F64]:
    """Move skeleton and vertices alike, so that the lowest vertex is on y = 0 and the pelvis over the origin.

    Missing ankles and balls of the feet are placed in the shoes, as motions and tracking use them for the sole's
    height. They move no vertex, so the picture does not change.
    """
    bones = skeleton.bone_matrices(np.zeros((len(skeleton), 3)))
    posed = np.zeros_like(vertices)
    for column in range(joints.shape[1]):
        rows = bones[joints[:, column], :3]
        posed += weights[:, column, None] * (np.einsum("vij,vj->vi", rows[:, :, :3], vertices) + rows[:, :, 3])
    shift = np.array([-skeleton.joints[0, 0], -posed[:, 1].min(), -skeleton.joints[0, 2]])
    rest, inverse = skeleton.rest.copy(), skeleton.inverse_bind.copy()
    rest[:, :3, 3] += shift
    inverse[:, :3, 3] -= inverse[:, :3, :3] @ shift
    heaviest = strongest_joint(joints, weights)
    stature = float(np.ptp(posed[:, 1]))
    for side in ("left", "right"):
        ankle, ball = _AT[f"{side}_ankle"], _AT[f"{side}_foot"]
        moved = rest[[ankle, ball], :3, 3]
        if f"{side}_ankle" not in known:
            rest[ankle, 1, 3] = np.clip(rest[ankle, 1, 3], _ANKLE * stature, rest[_AT[f"{side}_knee"], 1, 3])
        if f"{side}_foot" not in known:
            shoe = posed[np.isin(heaviest, (ankle, ball))] + shift
            rest[ball, 1, 3] = min(_SOLE * stature, max(float(rest[ankle, 1, 3]), 0.0) / 2)
            if len(shoe) and np.ptp(shoe[:, 2]) > 0:
                least = (rest[ankle, 2, 3] + rest[ball, 2, 3]) / 2  # a box for a shoe has no front
                rest[ball, 2, 3] = max(float(shoe[:, 2].min() + _BALL * np.ptp(shoe[:, 2])), float(least))
        for joint, before in zip((ankle, ball), moved, strict=True):  # the zero pose moves no vertex
            inverse[joint, :3, 3] += before - rest[joint, :3, 3]
    return Skeleton(skeleton.names, skeleton.parents, rest, inverse), vertices + shift


def faces_back(
    skeleton: Skeleton,
    vertices: F64,  # [V, 3] as bound
    joints: NDArray[np.int64],  # [V, K]
    weights: F64,  # [V, K]
    known: Collection[str],
) -> bool:
    """Return whether both feet point backwards: then the file's left is the right.

    The toes decide where the rig has them, else the shoes as they were bound.
    """
    heaviest = strongest_joint(joints, weights)
    bound = np.linalg.inv(skeleton.inverse_bind)
    votes = []
    for side in ("left", "right"):
        ankle, ball = _AT[f"{side}_ankle"], _AT[f"{side}_foot"]
        if not {f"{side}_ankle", f"{side}_foot"} - set(known):
            votes.append(bound[ball, 2, 3] < bound[ankle, 2, 3])
            continue
        shoe = vertices[np.isin(heaviest, (ankle, ball)), 2] - bound[ankle, 2, 3]
        votes.append(len(shoe) > 0 and -shoe.min() > _CLEARLY * max(float(shoe.max()), 0.0))
    return all(votes)


def read_rig_map(path: str | Path) -> dict[str, str | None]:
    """Read the map from a JSON file. Raises FormatError naming the file and the entry."""
    with naming(path):
        found = read_json(path, "a rig map", _LARGEST)
        if not isinstance(found, dict) or not found:
            raise FormatError('a rig map is an object of names, {"left_hip": "MyThigh_L", "jaw": null, ...}')
        for joint, name in found.items():
            if joint not in JOINT_NAMES:
                raise FormatError(f'a rig map names joints of SMPL-X (left_hip, ...), not "{joint:.40}"')
            if name is not None and not isinstance(name, str):
                raise FormatError(f"{joint} needs the name of a node, or null, not {name!r:.40}")
        return found
