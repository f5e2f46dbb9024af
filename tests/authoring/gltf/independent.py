"""glTF 2.0's skinning (3.7.3.3), written from the specification with pygltflib and nothing of glsplat's readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class File:
    """A parsed .glb: nodes, and what its meshes are bound to."""

    def __init__(self, path: Path) -> None:
        self.gltf = pygltflib.GLTF2().load_binary(str(path))
        self.blob = self.gltf.binary_blob()
        self.parents = {child: n for n, node in enumerate(self.gltf.nodes) for child in node.children or []}

    def values(self, index: int) -> np.ndarray:
        accessor = self.gltf.accessors[index]
        view = self.gltf.bufferViews[accessor.bufferView]
        dtype, width = np.dtype(_TYPES[accessor.componentType]), _WIDTHS[accessor.type]
        step = view.byteStride or dtype.itemsize * width
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        strides = (step, dtype.itemsize)
        out = np.ndarray((accessor.count, width), dtype, self.blob, start, strides).copy()
        if accessor.normalized:
            out = np.maximum(out / float(np.iinfo(dtype).max), -1)
        return out

    def local(self, index: int) -> np.ndarray:
        node = self.gltf.nodes[index]
        if node.matrix is not None:
            return np.array(node.matrix, np.float64).reshape(4, 4).T
        out = np.eye(4)
        if node.rotation is not None:
            x, y, z, w = np.array(node.rotation) / np.linalg.norm(node.rotation)
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            out[:3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        if node.scale is not None:
            out[:3, :3] = out[:3, :3] * np.array(node.scale)
        if node.translation is not None:
            out[:3, 3] = node.translation
        return out

    def world(self, locals_: dict[int, np.ndarray]) -> np.ndarray:
        """[N, 4, 4] global transforms; ``locals_`` in place of the file's own."""
        out: dict[int, np.ndarray] = {}

        def of(index: int) -> np.ndarray:
            if index not in out:
                own = locals_.get(index, self.local(index))
                out[index] = of(self.parents[index]) @ own if index in self.parents else own
            return out[index]

        return np.array([of(index) for index in range(len(self.gltf.nodes))])

    def skin_joints(self) -> dict[int, np.ndarray]:
        """Node -> where it was bound, in the space of the skin with the most vertices, for that skin's joints."""
        sizes: dict[int, int] = {}
        for node in self.gltf.nodes:
            if node.mesh is not None and node.skin is not None:
                for primitive in self.gltf.meshes[node.mesh].primitives:
                    count = self.gltf.accessors[primitive.attributes.POSITION].count
                    sizes[node.skin] = sizes.get(node.skin, 0) + count
        skin = self.gltf.skins[max(sizes, key=lambda s: (sizes[s], -s))]
        inverse = self.values(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
        return {joint: np.linalg.inv(inverse[k]) for k, joint in enumerate(skin.joints)}

    def vertices(self, world: np.ndarray) -> np.ndarray:
        """[V, 3] of all skinned primitives in the order of the scene, depth first."""
        parts = []
        pending = list(reversed(self.gltf.scenes[self.gltf.scene or 0].nodes))
        while pending:
            index = pending.pop()
            node = self.gltf.nodes[index]
            pending.extend(reversed(node.children or []))
            if node.mesh is None or node.skin is None:
                continue
            skin = self.gltf.skins[node.skin]
            inverse = self.values(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
            bones = world[skin.joints] @ inverse
            for primitive in self.gltf.meshes[node.mesh].primitives:
                points = self.values(primitive.attributes.POSITION).astype(np.float64)
                ids, weights = self.values(primitive.attributes.JOINTS_0), self.values(primitive.attributes.WEIGHTS_0)
                weights = weights / weights.sum(axis=1, keepdims=True)
                blended = np.einsum("vk,vkij->vij", weights, bones[ids.astype(int)])
                parts.append(np.einsum("vij,vj->vi", blended[:, :3, :3], points) + blended[:, :3, 3])
        return np.concatenate(parts)
