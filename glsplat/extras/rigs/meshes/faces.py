"""Expressions of a file's meshes under ARKit's names, from morph targets and VRM expressions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.rigs.vrm import face_binds
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.morphs import read_morphs
from glsplat.formats.gltf.nodes import Instance
from glsplat.meshes import Morphs
from glsplat.skinning.expression import ARKIT, arkit_name


class Faces:
    """Collects expressions, primitive by primitive."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self._said = face_binds(container.gltf)
        self._found: dict[str, list[tuple[NDArray[np.integer], NDArray[np.floating]]]] = {}

    def add(self, instance: Instance, node: int, first: int, linear: F64) -> int:
        """Add an instance's expressions; at ``node``, its vertices start at ``first`` and were moved by ``linear``
        [3, 3] or [V, 3, 3]. Returns the number of its targets in no expression. Raises FormatError."""
        primitive, mesh = instance.primitive, instance.node.mesh
        if not primitive.targets or mesh is None:
            return 0
        morphs = read_morphs(self._container, item(self._container.gltf.meshes, mesh, "mesh"), primitive)
        if not np.isfinite(morphs.offsets).all():
            raise FormatError(f"{instance.name}: the morph targets need finite offsets, found NaN or infinity")
        used: set[int] = set()
        for name, targets in self._targets(morphs, node, mesh).items():
            for target, weight in targets:
                part = slice(*morphs.starts[target : target + 2])
                rows = morphs.vertices[part]
                turn = linear[rows] if linear.ndim == 3 else linear
                moved = weight * np.einsum("...ij,...j->...i", turn, morphs.offsets[part].astype(np.float64))
                self._found.setdefault(name, []).append((rows.astype(np.int64) + first, moved))
                used.add(target)
        return len(morphs) - len(used)

    def morphs(self) -> Morphs | None:
        """Return all expressions, in ARKit's order; None without any."""
        found = {name: self._found[name] for name in ARKIT if name in self._found}
        return Morphs.of(found) if found else None

    def _targets(self, morphs: Morphs, node: int, mesh: int) -> dict[str, list[tuple[int, float]]]:
        """Return ARKit's name -> (target, weight); a target's own name has priority over a VRM's expressions."""
        out: dict[str, list[tuple[int, float]]] = {}
        for target, name in enumerate(morphs.names):
            known = arkit_name(name)
            if known is not None and known not in out:
                out[known] = [(target, 1.0)]
        for name, binds in self._said.items():
            known = arkit_name(name)
            mine = [
                (target, weight)
                for of_node, of_mesh, target, weight in binds
                if (of_node == node or of_mesh == mesh) and 0 <= target < len(morphs)
            ]
            if known is not None and known not in out and mine:
                out[known] = mine
        return out
