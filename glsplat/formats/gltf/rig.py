"""The rig of an avatar or a mesh in glTF: a skin's joint nodes and inverse bind matrices, JOINTS_n and WEIGHTS_n."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.nodes import Graph, Instance
from glsplat.formats.gltf.output import Output
from glsplat.formats.gltf.schema import Gltf, Node
from glsplat.formats.gltf.schema import Skin as SkinObject
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import INFLUENCES, Skin

SKIN_WEIGHTS = "skin_weights"
"""In our extras: Skin.lost and Skin.repaired."""

MAX_JOINTS = 1 << 16  # of a skin: their indices have 16 bits

_DROPPED, _ROOTED = "skin weights (left out)", "vertices without weights (now on the root joint)"


def weights_note(skin: Skin) -> dict[str, Any]:
    """Return the extras on ``skin``; empty where nothing was lost."""
    return {SKIN_WEIGHTS: {"lost": skin.lost, "repaired": skin.repaired}} if skin.lost or skin.repaired else {}


def write_influences(out: Output, skin: Skin, joint_count: int, attributes: dict[str, int]) -> None:
    """Add JOINTS_n and WEIGHTS_n to a primitive's ``attributes``."""
    columns = -(-skin.influences // 4) * 4
    pad = ((0, 0), (0, columns - skin.influences))
    joints = np.pad(skin.joints.astype(np.uint8 if joint_count <= 256 else np.uint16), pad)
    weights = np.pad(skin.weights, pad)
    joints[weights == 0] = 0  # the specification's value for an unused influence
    for i in range(columns // 4):
        part = slice(4 * i, 4 * i + 4)
        attributes[f"JOINTS_{i}"] = out.add(np.ascontiguousarray(joints[:, part]), "VEC4")
        attributes[f"WEIGHTS_{i}"] = out.add_shares(np.ascontiguousarray(weights[:, part]), "VEC4")


def write_skeleton(out: Output, skeleton: Skeleton) -> None:
    """Add joint nodes to the scene, and the skin of node 0."""
    inverse = skeleton.inverse_bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32)
    gltf = out.gltf
    first = len(gltf.nodes)
    with np.errstate(all="ignore"):
        child = skeleton.parents >= 0
        local = skeleton.rest.copy()
        local[child] = np.linalg.solve(skeleton.rest[skeleton.parents[child]], skeleton.rest[child])
    for name, matrix in zip(skeleton.names, local, strict=True):
        node = Node(name=name)
        if np.array_equal(matrix[:3, :3], np.eye(3)) and np.array_equal(matrix[3], (0, 0, 0, 1)):
            node.translation = matrix[:3, 3].tolist()
        else:
            node.matrix = matrix.T.reshape(-1).tolist()
        gltf.nodes.append(node)
    roots = gltf.scenes[0].nodes
    if (skeleton.parents < 0).sum() > 1:  # the joints of a skin need a common root (glTF 2.0, 3.7.3.1)
        roots.append(len(gltf.nodes))
        gltf.nodes.append(Node(name="rig"))
        roots = gltf.nodes[-1].children
    for j, parent in enumerate(skeleton.parents):
        (roots if parent < 0 else gltf.nodes[first + parent].children).append(first + j)
    gltf.skins = [
        SkinObject(
            joints=list(range(first, first + len(skeleton))),
            inverse_bind_matrices=out.add(inverse, "MAT4", target=None),
        )
    ]
    gltf.nodes[0].skin = 0


def read_skeleton(container: Container, instance: Instance, graph: Graph) -> Skeleton:
    """Read the joints of a node's skin: rest frames are the global node transforms, at the skin's inverse binds.

    Raises FormatError when they are no usable rig.
    """
    gltf, skin = container.gltf, instance.node.skin or 0
    inverse = inverse_binds(container, skin)
    nodes = gltf.skins[skin].joints
    try:
        with np.errstate(all="ignore"):
            return Skeleton(joint_names(gltf, nodes), joint_parents(nodes, graph), graph.world[nodes], inverse)
    except PoseError as error:
        raise FormatError(f"the skin is not a usable rig: {error}") from None


def inverse_binds(container: Container, skin: int) -> NDArray[np.float64]:
    """Read the inverse bind matrices [J, 4, 4] of a skin; identities where it has none (glTF 2.0, 5.28).

    Raises FormatError where its joints are not distinct nodes of the file, or there are fewer matrices.
    """
    found = item(container.gltf.skins, skin, "skin")
    nodes, count = found.joints, len(found.joints)
    for node in nodes:
        item(container.gltf.nodes, node, "joint node")
    if count > MAX_JOINTS:
        raise FormatError(f"a skin needs at most {MAX_JOINTS} joints, found {count}")
    if not nodes or len(set(nodes)) != count:
        raise FormatError(f"a skin needs distinct joint nodes, found {len(set(nodes))} distinct among {count}")
    if found.inverse_bind_matrices is None:
        return np.tile(np.eye(4), (count, 1, 1))
    matrices = container.numbers(found.inverse_bind_matrices, "inverseBindMatrices", ("MAT4",))
    if len(matrices) < count:
        raise FormatError(f"a skin of {count} joints has only {len(matrices)} inverse bind matrices")
    with np.errstate(invalid="ignore"):  # casting a signalling NaN warns
        return matrices[:count].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def joint_names(gltf: Gltf, nodes: Sequence[int]) -> tuple[str, ...]:
    """Return the names of joint nodes; those that glTF lets be absent or equal are numbered."""
    names: dict[str, None] = {}
    for j, node in enumerate(nodes):
        name = gltf.nodes[node].name or f"joint_{j}"
        names[name if name not in names else f"{name}_{j}"] = None
    return tuple(names)


def joint_parents(nodes: Sequence[int], graph: Graph) -> NDArray[np.int32]:
    """Return for each joint node the index of its nearest ancestor among them, -1 without one."""
    joint = {node: j for j, node in enumerate(nodes)}
    nearest = {-1: -1}  # node -> index of itself or of its nearest ancestor that is a joint
    for node in graph.order:
        nearest[node] = joint.get(node, nearest[int(graph.parents[node])])
    return np.array([nearest[int(graph.parents[node])] for node in nodes], np.int32)


@dataclass(frozen=True, eq=False)
class Influences:
    """JOINTS_n and WEIGHTS_n of a primitive, K = 4 or 8, as they are stored but for weights that are not finite."""

    joints: NDArray[np.int64]  # [N, K] of the skin's list; not checked
    weights: NDArray[np.float32]  # [N, K] finite, of any sign and sum
    mended: NDArray[np.bool_]  # [N] has lost a weight that was not finite
    rooted: NDArray[np.bool_]  # [N] had no other, and is bound to the skin's root


def read_influences(container: Container, instance: Instance, count: int) -> Influences:
    """Read the influences of ``count`` vertices or splats.

    Weights that are NaN or infinite are dropped, and counted for ``Container.warn``. Raises FormatError when counts or
    types do not fit.
    """
    attributes, where = instance.primitive.attributes, instance.name
    sets = [s for s in (0, 1) if f"JOINTS_{s}" in attributes and f"WEIGHTS_{s}" in attributes]
    if 0 not in sets:
        raise FormatError(f"{where}: JOINTS_0 needs WEIGHTS_0 beside it")
    ids = [container.read(attributes[f"JOINTS_{s}"], f"{where} JOINTS_{s}", ("VEC4",)) for s in sets]
    read = [
        container.finite(attributes[f"WEIGHTS_{s}"], f"{where} WEIGHTS_{s}", ("VEC4",), _DROPPED, 0, whole=False)
        for s in sets
    ]
    if {len(a) for a in (*ids, *(values for values, _ in read))} != {count} or any(a.dtype.kind != "u" for a in ids):
        raise FormatError(f"{where}: JOINTS and WEIGHTS need {count} elements of whole numbers, as POSITION has")
    joints, weights = np.hstack(ids).astype(np.int64), np.hstack([values for values, _ in read])
    bad = np.hstack([dropped for _, dropped in read])
    mended: NDArray[np.bool_] = np.zeros(count, bool)
    rooted: NDArray[np.bool_] = np.zeros(count, bool)
    if bad.any():
        mended = np.any(bad, axis=1)
        rooted = np.logical_and(mended, weights.max(axis=1, initial=0) <= 0)
    if rooted.any():
        rows = np.flatnonzero(rooted)
        slots = bad[rows].argmax(axis=1)  # of what was dropped: what else the row holds, be it negative, stays
        joints[rows, slots], weights[rows, slots] = _root(container.gltf, instance.node.skin or 0), 1
        container.mended(attributes["WEIGHTS_0"], _ROOTED, len(rows))
    return Influences(joints, weights, mended, rooted)


def _root(gltf: Gltf, skin: int) -> int:
    """Return the index of the first of a skin's joints that hangs from no other of them."""
    joints = item(gltf.skins, skin, "skin").joints
    pending, below = [child for node in joints for child in item(gltf.nodes, node, "node").children], set[int]()
    while pending:
        node = pending.pop()
        if node not in below:
            below.add(node)
            pending.extend(gltf.nodes[node].children)
    return next((index for index, node in enumerate(joints) if node not in below), 0)


def read_skin(container: Container, instance: Instance, joints: int, count: int, noted: Any) -> Skin:
    """Read the influences of ``count`` splats on ``joints`` joints, with the smallest K that holds them all.

    ``noted`` may be what ``weights_note`` said of an earlier reduction. Raises FormatError when counts or types do not
    fit, or a splat is bound to a joint the skin lacks.
    """
    stored = noted if isinstance(noted, dict) else {}
    found = read_influences(container, instance, count)
    ids_all, w = found.joints, found.weights
    used = int(np.einsum("nk->n", (w != 0).astype(np.uint8)).max(initial=1))
    influences = next(k for k in INFLUENCES if k >= used)
    sorted_rows = bool((w[:, 1:-1] >= w[:, 2:]).all()) and bool((w >= 0).all()) and bool((w[:, 0] > 0).all())
    whole = sorted_rows and not found.mended.any()
    if whole and np.abs(w.sum(axis=1, dtype=np.float64) - 1).max(initial=0) <= 8 * 2**-24:
        # already as Skin.create or Skin.anchored would make it: renormalising again would only move the last bits
        ids_all = np.where(w > 0, ids_all, ids_all[:, :1])
        if ids_all.max(initial=0) < joints:
            lost, repaired = stored.get("lost"), stored.get("repaired")
            return Skin(
                np.ascontiguousarray(ids_all[:, :influences], np.uint16),
                np.ascontiguousarray(w[:, :influences]),
                float(lost) if isinstance(lost, (int, float)) else 0.0,
                repaired if isinstance(repaired, int) else 0,
            )
    skin = Skin.create(ids_all, w, joints, influences)
    mended = int((found.mended & ~(w < 0).any(axis=1)).sum())  # those with a negative one, too, it has counted
    return replace(skin, repaired=skin.repaired + mended) if mended else skin
