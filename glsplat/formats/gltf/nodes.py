"""The scene graph of a glTF file: global matrices of its nodes, and the primitives that they show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.formats.gltf.container import item
from glsplat.formats.gltf.schema import Gltf, Node, Primitive
from glsplat.rotations import quaternion_matrices


@dataclass(frozen=True)
class Instance:
    """One primitive, shown by one node."""

    primitive: Primitive
    node: Node
    matrix: F64
    name: str  # for messages
    index: int  # of the node


@dataclass(frozen=True)
class Graph:
    """The tree of nodes."""

    parents: NDArray[np.int64]  # [N] index of the parent node, -1 for a root
    order: list[int]  # parents before children
    world: F64  # [N, 4, 4] global matrices


def only_moves(gltf: Gltf) -> bool:
    """Return whether a file has animations and no primitives."""
    return bool(gltf.animations) and not any(mesh.primitives for mesh in gltf.meshes)


def graph_of(gltf: Gltf) -> Graph:
    """Return parents and global matrices of all nodes; FormatError for a node with two parents or a cycle."""
    count = len(gltf.nodes)
    parents = np.full(count, -1)
    for i, node in enumerate(gltf.nodes):
        for child in node.children:
            item(gltf.nodes, child, "node")
            if parents[child] >= 0 or child == i:
                raise FormatError(f"node {child} has more than one parent, but nodes need to form a tree")
            parents[child] = i
    world = np.empty((count, 4, 4))
    pending = np.flatnonzero(parents < 0).tolist()
    order: list[int] = []
    with np.errstate(all="ignore"):  # a matrix that overflows is refused where it is used
        while pending:
            i = pending.pop()
            order.append(i)
            local = _local(gltf.nodes[i])
            world[i] = local if parents[i] < 0 else world[parents[i]] @ local
            pending.extend(gltf.nodes[i].children)
    if len(order) < count:
        raise FormatError(f"{count - len(order)} nodes form a cycle, but nodes need to form a tree")
    return Graph(parents, order, world)


def _local(node: Node) -> F64:
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T
    out = np.eye(4)
    if node.rotation is not None:
        quat = np.array(node.rotation) / (np.linalg.norm(node.rotation) or 1.0)
        out[:3, :3] = quaternion_matrices(np.roll(quat, 1))
    if node.scale is not None:
        out[:3, :3] *= node.scale
    if node.translation is not None:
        out[:3, 3] = node.translation
    return out


def instances(gltf: Gltf, world: F64, extension: str = "") -> Iterator[Instance]:
    """Yield the primitives in the default scene, or of all nodes in a file without; those with ``extension``."""
    pending = list(range(len(gltf.nodes)))[::-1]
    descend = bool(gltf.scenes)
    if descend:
        scene = item(gltf.scenes, gltf.scene or 0, "scene")
        pending = list(dict.fromkeys(scene.nodes))[::-1]
    seen: set[int] = set()
    while pending:
        i = pending.pop()
        node = item(gltf.nodes, i, "node")
        if i in seen:
            continue
        seen.add(i)
        if descend:
            pending.extend(reversed(node.children))
        if node.mesh is None:
            continue
        for p, primitive in enumerate(item(gltf.meshes, node.mesh, "mesh").primitives):
            if not extension or extension in primitive.extensions:
                yield Instance(primitive, node, world[i], f"mesh {node.mesh} primitive {p}", i)
