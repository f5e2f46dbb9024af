"""Morph targets of a glTF primitive: how far each of its vertices moves for each named expression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Accessor, Container, Index, Mesh, Primitive, item

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


class _Part(msgspec.Struct, rename="camel"):
    buffer_view: Index
    byte_offset: Index = 0
    component_type: int = 5126


class _Sparse(msgspec.Struct):
    count: Index
    indices: _Part
    values: _Part


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
    if accessor.sparse is not None and accessor.buffer_view is not None:
        raise FormatError(f"{where} is a sparse accessor over another one, which is not supported; store it densely")
    if accessor.sparse is None:
        values = container.numbers(index, where, ("VEC3",))
        rows = np.flatnonzero(values.any(axis=1))
        return rows.astype(np.uint32), values[rows]
    try:
        sparse = msgspec.convert(accessor.sparse, _Sparse)
    except msgspec.ValidationError as error:
        raise FormatError(f"{where} is a broken sparse accessor: {str(error)[:120]}") from None
    rows = _read(container, sparse.indices, sparse.count, "SCALAR", f"{where} indices")[:, 0]
    if rows.dtype.kind != "u" or sparse.count > count or (len(rows) and int(rows.max()) >= count):
        raise FormatError(f"{where} needs indices of its {count} vertices as unsigned integers")
    part = msgspec.structs.replace(sparse.values, component_type=accessor.component_type)
    values = _read(container, part, sparse.count, accessor.type, f"{where} offsets")
    if values.shape[1] != 3 or values.dtype.kind != "f":
        raise FormatError(f"{where} needs offsets of three floats")
    return rows.astype(np.uint32), np.ascontiguousarray(values, np.float32)


def _read(container: Container, part: _Part, count: int, kind: str, where: str) -> NDArray[Any]:
    """Through an accessor of its own, so that the bounds are checked in one place."""
    accessor = Accessor(
        component_type=part.component_type,
        count=count,
        type=kind,
        buffer_view=part.buffer_view,
        byte_offset=part.byte_offset,
    )
    container.gltf.accessors.append(accessor)
    return container.read(len(container.gltf.accessors) - 1, where, ("SCALAR", "VEC3"))
