"""Bind frames and names of the joints of a glTF file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from glsplat.arrays import F64
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Graph
from glsplat.formats.gltf.rig import inverse_binds


@dataclass(frozen=True, eq=False)
class Bound:
    """Bind frames of a file's nodes."""

    frames: F64  # [N, 4, 4] of all nodes, in the space in which the first skin's vertices are stored
    shown: F64  # [4, 4] the world from that space, as for most joints


def bound_of(container: Container, graph: Graph, skins: Sequence[int]) -> Bound:
    """Return the frames of all nodes when the first skin was bound; without skins, their rest frames."""
    world = graph.world
    if not skins:
        return Bound(world, np.eye(4))
    frames, shown = np.full_like(world, np.nan), np.eye(4)
    for place, skin in enumerate(skins):
        joints = container.gltf.skins[skin].joints
        inverse = inverse_binds(container, skin)
        known = [k for k, node in enumerate(joints) if np.isfinite(frames[node]).all()]
        to_first = np.eye(4)
        if place and known:  # another skin may be stored in another space; shared joints give it
            to_first = frames[joints[known[0]]] @ inverse[known[0]]
        elif place:
            to_first = np.linalg.solve(shown, world[joints[0]] @ inverse[0])
        for k, node in enumerate(joints):
            if not np.isfinite(frames[node]).all():
                frames[node] = to_first @ np.linalg.inv(inverse[k])
        if not place:
            shown = _usual(world[joints] @ inverse)
    for node in graph.order:  # parents first: a node of no skin keeps its rest frame under its parent
        if not np.isfinite(frames[node]).all():
            parent = int(graph.parents[node])
            anchored = parent >= 0 and np.isfinite(frames[parent]).all()
            above = frames[parent] @ np.linalg.inv(world[parent]) if anchored else np.linalg.inv(shown)
            frames[node] = above @ world[node]
    return Bound(frames, shown)


def _usual(placed: F64) -> F64:
    """Return the matrix [4, 4] of [J, 4, 4] that is nearest to all; joints without vertices may have any."""
    some = placed[:: max(1, len(placed) // 200)].reshape(-1, 16)
    apart = np.abs(some[:, None] - some[None]).sum(axis=(1, 2))
    return some[int(apart.argmin())].reshape(4, 4)


def names_of_joints(container: Container, skins: Sequence[int], given: Mapping[str, int | None]) -> list[str]:
    """Return the names of all nodes, "" for those that cannot be joints, such as a mesh called "Head"."""
    gltf = container.gltf
    may = {node for skin in skins for node in gltf.skins[skin].joints} | {
        node for node in given.values() if node is not None
    }
    if not skins:  # a doll of rigid parts: its nodes are its joints
        may |= set(range(len(gltf.nodes)))
    return [node.name or "" if index in may else "" for index, node in enumerate(gltf.nodes)]
