"""Morph targets of a glTF primitive: how far each of its vertices moves for each named expression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, Mesh, Primitive, item

__all__ = ["Morphs", "read_morphs"]

_TARGETS = 1024
_ROWS = 1 << 23  # of all targets together, 134 MB: targets may share data, and a small file must not become a huge one


@dataclass(frozen=True, eq=False, repr=False)
class Morphs:
    """Offsets of vertices in metres in the mesh's own space, those that are not zero: T targets, M offsets in all.

    Target t, called ``names[t]``, at weight w moves vertex ``vertices[i]`` by w ``offsets[i]`` for the i from
    ``starts[t]`` to ``starts[t + 1]``; targets add up (glTF 2.0, 3.7.2.2).
    """

    names: tuple[str, ...]
    starts: NDArray[np.int64]  # [T + 1]
    vertices: NDArray[np.uint32]  # [M]
    offsets: NDArray[np.float32]  # [M, 3]

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        return f"Morphs({len(self.names)} targets, {len(self.vertices)} offsets)"


def read_morphs(container: Container, mesh: Mesh, primitive: Primitive) -> Morphs:
    """The POSITION targets of a primitive of ``mesh``; a target of normals alone moves nothing.

    Names are those of ``extras.targetNames``, as exporters write them, else target_0 and so on. Raises FormatError
    for offsets that are not three floats for each vertex.
    """
    targets = primitive.targets
    if len(targets) > _TARGETS:
        raise FormatError(f"a mesh has at most {_TARGETS} morph targets, this one {len(targets)}")
    count = item(container.gltf.accessors, primitive.attributes["POSITION"], "accessor of POSITION").count
    vertices: list[NDArray[np.uint32]] = [np.empty(0, np.uint32)]
    offsets: list[NDArray[np.float32]] = [np.empty((0, 3), np.float32)]
    starts = [0]
    for number, target in enumerate(targets):
        where = f"morph target {number}"
        if "POSITION" in target:
            rows, values = _target(container, target["POSITION"], where, count)
            vertices.append(rows)
            offsets.append(values)
        starts.append(starts[-1] + (len(vertices[-1]) if "POSITION" in target else 0))
        if starts[-1] > _ROWS:
            raise FormatError(f"the morph targets move more than {_ROWS} vertices altogether")
    names = mesh.extras.get("targetNames") if isinstance(mesh.extras, dict) else None
    if not (isinstance(names, list) and len(names) == len(targets) and all(isinstance(name, str) for name in names)):
        names = [f"target_{number}" for number in range(len(targets))]
    return Morphs(tuple(names), np.array(starts), np.concatenate(vertices), np.concatenate(offsets))


def _target(container: Container, index: int, where: str, count: int) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Which vertices one target moves, and by how much."""
    accessor = item(container.gltf.accessors, index, f"accessor of {where}")
    if accessor.count != count:
        raise FormatError(f"{where} needs {count} offsets, as there are vertices, not {accessor.count}")
    if accessor.sparse is None or accessor.buffer_view is not None:
        values = container.numbers(index, where, ("VEC3",))
        rows = np.flatnonzero(values.any(axis=1))
        return rows.astype(np.uint32), values[rows]
    which, offsets = container.sparse(index, where, ("VEC3",))
    if offsets.dtype.kind != "f":
        raise FormatError(f"{where} needs offsets of three floats")
    return which.astype(np.uint32), np.ascontiguousarray(offsets, np.float32)
