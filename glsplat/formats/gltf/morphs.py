"""Morph targets of a glTF primitive (2.0, 3.7.2.2): of a mesh's vertices, and of splats, which are an avatar's shapes.

POSITION of splats is in metres, so that any viewer of morph targets moves the same points: floats, or normalised signed
shorts (KHR_mesh_quantization) where all shapes are in 32767ths of a metre. The attributes _AXIS_0 and _AXIS_1 (vectors
of normalised signed bytes, the fourth 0) bend a splat's long axes. All are sparse accessors without a bufferView; the
axes share POSITION's list of splats where all of them bend, else they have their own. Names are in the mesh's
``extras.targetNames``; the primitive's ``extras.glsplat`` has ``shape_sizes`` and, where they are not 0 and 1,
``shape_limits``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.nodes import Instance
from glsplat.formats.gltf.output import Output
from glsplat.formats.gltf.primitive import our_extras
from glsplat.formats.gltf.schema import Accessor, Mesh, Primitive
from glsplat.meshes import Morphs
from glsplat.skinning.expression import MOST_NAMES, arkit_name
from glsplat.skinning.shapes import BEND, LIMITS, Shapes

QUANTIZATION = "KHR_mesh_quantization"
"""Extension that allows normalised integers as offsets."""

SHORT: np.float32 = np.float32(1) / np.float32(32767)
"""Metres a unit of ``Shapes.moves`` that a file stores unchanged: normalised signed 16 bits."""

_MAX_TARGETS = 1024
_MAX_ROWS = 1 << 23  # of all targets, 134 MB: targets may share data, so the file's size does not bound them
_AXES = ("_AXIS_0", "_AXIS_1")
_SIZES, _LIMITS = "shape_sizes", "shape_limits"
_MAX_ENTRIES = 1 << 24


def read_morphs(container: Container, mesh: Mesh, primitive: Primitive) -> Morphs:
    """Read the POSITION targets of a primitive of ``mesh``; a target of normals alone moves nothing.

    Names are those of ``extras.targetNames``, as exporters write them, else target_0 and so on. Raises FormatError
    for offsets that are not three floats for each vertex.
    """
    targets = primitive.targets
    if len(targets) > _MAX_TARGETS:
        raise FormatError(f"a mesh has at most {_MAX_TARGETS} morph targets, this one {len(targets)}")
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
        if starts[-1] > _MAX_ROWS:
            raise FormatError(f"the morph targets move more than {_MAX_ROWS} vertices altogether")
    names = mesh.extras.get("targetNames") if isinstance(mesh.extras, dict) else None
    if not (isinstance(names, list) and len(names) == len(targets) and all(isinstance(name, str) for name in names)):
        names = [f"target_{number}" for number in range(len(targets))]
    return Morphs(tuple(names), np.array(starts), np.concatenate(vertices), np.concatenate(offsets))


def _target(container: Container, index: int, where: str, count: int) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Read which vertices one target moves, and by how much."""
    accessor = item(container.gltf.accessors, index, f"accessor of {where}")
    if accessor.count != count:
        raise FormatError(f"{where} needs {count} offsets, as there are vertices, not {accessor.count}")
    if accessor.sparse is None and accessor.buffer_view is None:  # zeros (glTF 2.0, 5.1.1)
        return np.empty(0, np.uint32), np.empty((0, 3), np.float32)
    if accessor.sparse is None or accessor.buffer_view is not None:
        values = container.numbers(index, where, ("VEC3",))
        rows = np.flatnonzero(values.any(axis=1))
        return rows.astype(np.uint32), values[rows]
    which, offsets = container.sparse(index, where, ("VEC3",))
    if offsets.dtype.kind not in "fi":
        raise FormatError(f"{where} needs offsets of three floats or signed integers")
    return which.astype(np.uint32), container.decoded(index, offsets)


def write_shapes(out: Output, shapes: Shapes, mesh: Mesh, primitive: Primitive) -> None:
    """Add targets to ``primitive``, the one of ``mesh``, with names, sizes and limits."""
    rows = shapes.rows
    narrow, whole = index_code(shapes.splats), bool((shapes.sizes == SHORT).all())
    for target in range(len(shapes)):
        mine = np.flatnonzero(shapes.targets == target)
        indices = out.add_bytes(rows[mine].astype(narrow).tobytes()) if len(mine) else -1  # no bufferView is empty
        metres = shapes.moves[mine] if whole else np.ascontiguousarray(shapes.metres[mine], np.float32)
        attributes = {"POSITION": add_sparse(out, shapes.splats, indices, metres, "VEC3")}
        bent = mine[shapes.bends[mine].any(axis=(1, 2))]
        if len(bent):
            bends = np.pad(shapes.bends[bent], ((0, 0), (0, 0), (0, 1)))
            if len(bent) < len(mine):
                indices = out.add_bytes(rows[bent].astype(narrow).tobytes())
            for axis, name in enumerate(_AXES):
                values = np.ascontiguousarray(bends[:, axis])
                attributes[name] = add_sparse(out, shapes.splats, indices, values, "VEC4")
        primitive.targets.append(attributes)
    if any(_AXES[0] in target for target in primitive.targets):  # a target's attribute needs one of the primitive's
        for name in _AXES:
            zeros = Accessor(component_type=5120, count=shapes.splats, type="VEC4", normalized=True)
            out.gltf.accessors.append(zeros)
            primitive.attributes[name] = len(out.gltf.accessors) - 1
    if whole:
        out.needs(QUANTIZATION)
    extras = mesh.extras if isinstance(mesh.extras, dict) else {}
    mesh.extras = extras | {"targetNames": list(shapes.names)}
    ours: dict[str, Any] = {_SIZES: [float(size) for size in shapes.sizes]}
    if not np.array_equal(shapes.limits, np.tile(np.array(LIMITS, np.float32), (len(shapes), 1))):
        ours[_LIMITS] = shapes.limits.tolist()
    known = primitive.extras["glsplat"] if isinstance(primitive.extras, dict) else {}
    primitive.extras = {"glsplat": known | ours}


def index_code(count: int) -> str:
    """Return the type of ``add_sparse``'s indices into ``count`` elements, little endian."""
    return "<u2" if count <= 65536 else "<u4"


def add_sparse(out: Output, count: int, indices: int, values: NDArray[Any], kind: str) -> int:
    """Add an accessor of ``values`` at the rows in the bufferView ``indices``, zero elsewhere; return its index."""
    code = {"f": 5126, "b": 5120, "h": 5122}[values.dtype.char]
    accessor = Accessor(component_type=code, count=count, type=kind, normalized=code != 5126)
    if len(values):
        view = out.add_bytes(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes())
        accessor.sparse = {
            "count": len(values),
            "indices": {"bufferView": indices, "componentType": 5123 if count <= 65536 else 5125},
            "values": {"bufferView": view},
        }
    if kind == "VEC3":  # required of POSITION; what is not named is zero
        least, most = values.min(axis=0, initial=0), values.max(axis=0, initial=0)
        accessor.min, accessor.max = least.tolist(), most.tolist()
    out.gltf.accessors.append(accessor)
    return len(out.gltf.accessors) - 1


def shapes_of(container: Container, instance: Instance, count: int) -> Shapes | None:
    """Read the shapes of an instance's ``count`` splats; None where it has no targets. Raises FormatError."""
    primitive, mesh = instance.primitive, instance.node.mesh
    if not primitive.targets or mesh is None:
        return None
    ours = our_extras(primitive.extras)
    if len(primitive.targets) > MOST_NAMES:
        raise FormatError(f"an avatar has at most {MOST_NAMES} shapes, this one {len(primitive.targets)}")
    morphs = read_morphs(container, item(container.gltf.meshes, mesh, "mesh"), primitive)
    if not np.isfinite(morphs.offsets).all():
        raise FormatError("the morph targets need finite offsets, found NaN or infinity")
    names = shape_names(morphs.names)
    splats, targets = morphs.vertices.astype(np.int64), np.repeat(np.arange(len(names)), np.diff(morphs.starts))
    bends = np.zeros((len(splats), 2, 3))
    bent = [number for number, target in enumerate(primitive.targets) if any(name in target for name in _AXES)]
    more: list[tuple[NDArray[np.int64], int, NDArray[Any]]] = []
    for number in bent:
        rows, values = _axes(container, primitive.targets[number], f"morph target {number}", count)
        first, last = morphs.starts[number : number + 2]
        place = first + np.searchsorted(splats[first:last], rows)
        # where targets are in order, as glTF has them (3.6.2.3), and all that bends moves, as it is written here
        if len(rows) and first < last and np.array_equal(splats[np.minimum(place, last - 1)], rows):
            bends[place] = values
        else:
            more.append((rows, number, values))
    moves = morphs.offsets.astype(np.float64)
    if more:
        splats, targets, moves, bends = _together(count, (splats, targets, moves, bends), more)
    sizes, limits = _numbers(ours.get(_SIZES), (len(names),)), _numbers(ours.get(_LIMITS), (len(names), 2))
    if sizes is not None and not _fits(moves, sizes[targets]):
        sizes = None
    pairs = targets * count + splats
    if (np.diff(pairs) <= 0).any() and len(np.unique(pairs)) != len(pairs):  # in order they differ
        raise FormatError("a morph target names a splat twice")
    return Shapes.create(
        names, count, splats=splats, targets=targets, moves=moves, bends=bends, sizes=sizes, limits=limits
    )


def shape_names(names: tuple[str, ...]) -> list[str]:
    """Return targets' names, ARKit's where one is known under another maker's name; each once."""
    out: list[str] = []
    own = set(names)
    for number, name in enumerate(names):
        known = arkit_name(name)
        taken = known is None or known in out or (known != name and known in own)
        chosen = (name if taken or known is None else known)[:64] or f"target_{number}"
        out.append(chosen if chosen not in out else f"{chosen[:56]}_{number}")
    return out


def _axes(
    container: Container, target: dict[str, int], where: str, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read which splats a target bends [K], and how far [K, 2, 3]."""
    found: list[tuple[NDArray[np.int64], NDArray[Any]]] = []
    for name in _AXES:
        if name not in target:
            raise FormatError(f"{where} needs both {' and '.join(_AXES)}")
        accessor = item(container.gltf.accessors, target[name], f"accessor of {where}")
        if accessor.count != count or accessor.component_type != 5120:
            raise FormatError(f"{where}: {name} needs {count} elements of signed bytes")
        if accessor.sparse is not None and accessor.buffer_view is None:
            which, values = container.sparse(target[name], f"{where} {name}", ("VEC4",))
            found.append((which.astype(np.int64), values[:, :3]))
        elif accessor.buffer_view is not None:
            found.append((np.arange(count), container.read(target[name], f"{where} {name}", ("VEC4",))[:, :3]))
        else:
            found.append((np.empty(0, np.int64), np.empty((0, 3), np.int8)))
    (rows, first), (others, second) = found
    if not np.array_equal(rows, others):
        raise FormatError(f"{where}: {' and '.join(_AXES)} need the same splats")
    return rows, np.maximum(np.stack([first, second], axis=1).astype(np.float64), -127) * BEND


def _together(
    count: int,
    known: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]],
    more: list[tuple[NDArray[np.int64], int, NDArray[Any]]],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Merge entries that move and entries that bend into one for each splat and target."""
    splats = np.concatenate([known[0], *(rows for rows, _, _ in more)])
    targets = np.concatenate([known[1], *(np.full(len(rows), number) for rows, number, _ in more)])
    if len(splats) > _MAX_ENTRIES:
        raise FormatError(f"the morph targets have more than {_MAX_ENTRIES} entries altogether")
    keys, place = np.unique(targets * count + splats, return_inverse=True)
    moves, bends = np.zeros((len(keys), 3)), np.zeros((len(keys), 2, 3))
    moves[place[: len(known[0])]] = known[2]
    bends[place[: len(known[0])]] = known[3]
    at = len(known[0])
    for rows, _, values in more:
        bends[place[at : at + len(rows)]] = values
        at += len(rows)
    return keys % count, keys // count, moves, bends


def _numbers(value: Any, shape: tuple[int, ...]) -> NDArray[np.float32] | None:
    """Return finite numbers of that shape; None for all else: notes of others are no reason to refuse a file."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        return None
    if array.shape != shape or not np.isfinite(array).all() or (np.abs(array) > 1e30).any():
        return None
    return array.astype(np.float32)


def _fits(moves: NDArray[np.float64], units: NDArray[np.float32]) -> bool:
    """Return whether all moves are whole numbers of those units, as in files that ``write_shapes`` wrote."""
    steps = moves / np.maximum(units, np.float32(1e-30))[:, None]
    off = np.abs(steps - np.rint(steps)).max(initial=0)
    return bool((units >= 0).all() and off < 0.01 and np.abs(steps).max(initial=0) < 32768)
