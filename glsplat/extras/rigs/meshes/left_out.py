"""Count and name the parts of a glTF file that an avatar does not have."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Graph, Instance

TRIANGLES = (4, 5, 6)
_NAMED = 3  # names a line
_ROOM = 0.4  # of the joints' extent: how far worn things may be from the joints


@dataclass(eq=False)
class LeftOut:
    """Counts and names of left-out parts, by their kind."""

    counts: dict[str, int] = field(default_factory=dict)
    names: dict[str, list[str]] = field(default_factory=dict)

    def add(self, what: str, count: int = 1, name: str = "") -> None:
        """Add ``count`` of the kind ``what``; ``name`` is one of them."""
        if count:
            self.counts[what] = self.counts.get(what, 0) + count
            if name and name not in (known := self.names.setdefault(what, [])):
                known.append(name)

    def lines(self) -> list[str]:
        """Return a line for each kind: "3 meshes beside the person are left out (Floor, Cube, Lamp)"."""
        out = []
        for what, count in self.counts.items():
            names = [name[:40] for name in self.names.get(what, ())]
            more = ", ".join([*names[:_NAMED], "..."] if len(names) > _NAMED else names)
            out.append(f"{count} {what} ({more})" if more else f"{count} {what}")
        return out


def refuse_packed(instances: Sequence[Instance]) -> None:
    """Raise FormatError for compressed geometry (Draco)."""
    for instance in instances:
        packed = [name for name in instance.primitive.extensions if "compression" in name]
        if packed:
            raise FormatError(
                f"{instance.name}: the geometry is compressed ({packed[0][:60]}); "
                "unpack it: npx @gltf-transform/cli copy IN.glb OUT.glb"
            )


def survey(container: Container, everything: Sequence[Instance], left: LeftOut) -> None:
    """Count points, lines, meshes outside the scene, and animations."""
    gltf = container.gltf
    drawn = [i for i in everything if i.primitive.mode not in TRIANGLES]
    for instance in drawn:
        points = instance.primitive.mode == 0
        left.add(
            f"primitives of {'points' if points else 'lines'} are left out", 1, instance.node.name or instance.name
        )
    shown = {id(i.node) for i in everything}
    for node in gltf.nodes:
        if node.mesh is not None and id(node) not in shown and node.mesh < len(gltf.meshes):
            if gltf.meshes[node.mesh].primitives:
                left.add("meshes that are not in the default scene are left out", 1, node.name or f"mesh {node.mesh}")
    for number, animation in enumerate(gltf.animations):
        name = animation.get("name") if isinstance(animation, dict) else None
        left.add(
            "animations are no part of an avatar; --motion FILE#NAME plays one", 1, str(name or f"animation {number}")
        )


def carried(graph: Graph, joints: Collection[int]) -> NDArray[np.bool_]:
    """Return [N] whether a node is a joint or descends from one."""
    out = np.zeros(len(graph.parents) + 1, bool)  # the last is the parent of roots
    out[list(joints)] = True
    for node in graph.order:
        out[node] |= out[graph.parents[node]]
    return out[:-1]


def apart(graph: Graph, skeleton: Sequence[int], joints: Sequence[int]) -> bool:
    """Return whether a skin's ``skeleton`` is not that of the ``joints`` and stands beside it."""
    if carried(graph, joints)[list(skeleton)].any() or carried(graph, skeleton)[list(joints)].any():
        return False
    return nearest(graph, graph.world[list(skeleton)][:, :3, 3], joints) is None


def nearest(graph: Graph, points: F64, joints: Sequence[int]) -> int | None:
    """Return the joint that a rigid mesh, ``points`` [V, 3] in the world, follows; None for a prop of the scene.

    Hair or glasses are near the joints' box; a floor exceeds it.
    """
    where = graph.world[joints][:, :3, 3]
    low, high = where.min(axis=0), where.max(axis=0)
    room = _ROOM * float((high - low).max())
    if ((points < low - room) | (points > high + room)).any():
        return None
    return joints[int(np.linalg.norm(where - (points.min(axis=0) + points.max(axis=0)) / 2, axis=1).argmin())]
