"""SHA-256 of the arrays of a file's finest level, which hold a person's appearance."""

from __future__ import annotations

import hashlib

from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.levels import LOD, finest_of
from glsplat.formats.gltf.nodes import Instance, graph_of, instances
from glsplat.formats.gltf.primitive import EXTENSION, packed_view

_TYPES = ("SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4")


def level_digest(container: Container) -> tuple[str, bool]:
    """Return the SHA-256 (hex) of the attribute arrays of level 0, and whether the file shows anything else.

    The hash covers the primitives with splats in the order of the default scene, their attributes in the file's order,
    elements packed without padding; of SPZ its packed bytes; of an accessor without data, which means zeros (glTF 2.0,
    5.1.1), "zeros TYPE CODE COUNT". A file without splats is hashed by its triangles. Raises FormatError for missing
    arrays.
    """
    gltf = container.gltf
    graph = graph_of(gltf)
    every = list(instances(gltf, graph.world))
    splats = [one for one in every if EXTENSION in one.primitive.extensions]
    found = finest_of(splats) if splats else every
    if not found:
        raise FormatError("shows nothing that could be hashed")
    digest, seen = hashlib.sha256(), set()
    for one in found:
        if id(one.primitive) not in seen:  # two nodes may share a mesh
            seen.add(id(one.primitive))
            for part in _arrays(container, one):
                digest.update(part)
    only_finest = len(found) == len(every) and bool(splats) and not any(LOD in one.node.extensions for one in found)
    return digest.hexdigest(), not only_finest


def _arrays(container: Container, one: Instance) -> list[bytes]:
    view = packed_view(one.primitive.extensions[EXTENSION], one.name) if EXTENSION in one.primitive.extensions else None
    if view is not None:
        return [container.view(view, one.name)]
    return [_array(container, index, f"{one.name} {key}") for key, index in one.primitive.attributes.items()]


def _array(container: Container, index: int, what: str) -> bytes:
    accessor = item(container.gltf.accessors, index, f"accessor of {what}")
    if accessor.buffer_view is None and accessor.sparse is None:
        return f"zeros {accessor.type} {accessor.component_type} {accessor.count}".encode()
    return container.read(index, what, _TYPES).tobytes()
