"""Levels of detail in glTF: MSFT_lod on the node of the finest, and a node of its own for each coarser level.

Nodes of coarser levels are in no scene, so that viewers without the extension show the finest alone. The
``extras.glsplat`` of a level's node has its ``density`` in pixels a metre and its ``psnr`` in dB. The hint
MSFT_screencoverage is derived: the share of a picture of 1024 x 1024 pixels that the sphere around the finest covers
at that density.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from glsplat.avatar import Avatar, splats_of
from glsplat.errors import FormatError
from glsplat.formats.gltf.container import Container, item
from glsplat.formats.gltf.morphs import shapes_of, write_shapes
from glsplat.formats.gltf.nodes import Graph, Instance
from glsplat.formats.gltf.output import Output
from glsplat.formats.gltf.primitive import ANTIALIAS, EXTENSION, number_of, our_extras, read_splats, write_splats
from glsplat.formats.gltf.rig import SKIN_WEIGHTS, read_skeleton, read_skin, weights_note, write_influences
from glsplat.formats.gltf.schema import Mesh, Node
from glsplat.formats.transform import transformed
from glsplat.io.files import left_out
from glsplat.splats import Level, Splats

LOD = "MSFT_lod"
MAX_LEVELS = 16  # coarser levels that are read of a file

_COVERAGE = "MSFT_screencoverage"
_PICTURE_PX = 1024  # side of the picture of a coverage

log: logging.Logger = logging.getLogger("glsplat.formats")
Scene = TypeVar("Scene", bound=Splats | Avatar)


def write_levels(out: Output, scene: Splats | Avatar) -> None:
    """Add the coarser levels of ``scene``, which is node 0, if it has any; an avatar's share its skin."""
    if not scene.levels:
        return
    gltf, first = out.gltf, len(out.gltf.nodes)
    finest = splats_of(scene)
    levels: tuple[Level[Any], ...] = scene.levels
    for number, level in enumerate(levels, 1):
        content = level.content
        splats = splats_of(content)
        primitive = write_splats(out, splats, coarse=True)
        ours: dict[str, Any] = {"density": level.density}
        if level.psnr is not None:
            ours["psnr"] = level.psnr
        if splats.antialias != finest.antialias:
            ours[ANTIALIAS] = splats.antialias
        if isinstance(content, Avatar):
            write_influences(out, content.skin, len(content.skeleton), primitive.attributes)
            ours |= weights_note(content.skin)
        node = Node(name=f"splats level {number}", mesh=len(gltf.meshes), extras={"glsplat": ours})
        node.skin = gltf.nodes[0].skin
        gltf.meshes.append(Mesh(primitives=[primitive]))
        if isinstance(content, Avatar) and content.shapes is not None:
            write_shapes(out, content.shapes, gltf.meshes[-1], primitive)
        gltf.nodes.append(node)
    gltf.nodes[0].extensions = {LOD: {"ids": list(range(first, len(gltf.nodes)))}}
    gltf.nodes[0].extras = {_COVERAGE: _coverages(finest, [level.density for level in levels])}
    gltf.extensions_used.append(LOD)


def _coverages(splats: Splats, densities: list[float]) -> list[float]:
    """Return the coverages at which the finest and each level end, largest first; the last has no end."""
    points = splats.means[splats.finite()].astype(np.float64)
    low, high = np.percentile(points, (1, 99), axis=0) if len(points) else np.zeros((2, 3))
    radius = float(np.linalg.norm(high - low)) / 2
    return [float(f"{min(1.0, np.pi * (density * radius / _PICTURE_PX) ** 2):.6g}") for density in densities] + [0.0]


def finest_of(found: list[Instance]) -> list[Instance]:
    """Drop instances that another names as its coarser level: files of others may show those as well."""
    named = {index for one in found for index in _ids(one) if index != one.index}
    kept = [one for one in found if one.index not in named]
    return kept or found[:1]  # they name each other


def _ids(shown: Instance) -> list[int]:
    lod = shown.node.extensions.get(LOD)
    ids = lod.get("ids") if isinstance(lod, dict) else None
    return [index for index in ids if type(index) is int] if isinstance(ids, list) else []


def read_levels(container: Container, graph: Graph, found: list[Instance], scene: Scene) -> Scene:
    """Return ``scene`` with the usable levels that the file has of it; the others are logged.

    ``found`` is all that is shown, of which the first is ``scene``, before its node's transform.
    """
    with_levels = [one for one in found if LOD in one.node.extensions]
    if not with_levels:
        return scene
    if len(found) > 1:
        left_out(
            log, f"levels of detail are left out: they are read of one node with splats, the file shows {len(found)}"
        )
        return scene
    shown, ids = found[0], _ids(found[0])
    lod = shown.node.extensions[LOD]
    whole = lod.get("ids") if isinstance(lod, dict) else None
    if not isinstance(whole, list) or len(ids) < len(whole):
        left_out(log, f"levels of detail are left out: {LOD} needs ids, a list of nodes")
        return scene
    if len(ids) > MAX_LEVELS:
        left_out(log, f"{len(ids)} levels of detail, the first {MAX_LEVELS} are read")
    levels: list[tuple[int, Level[Any]]] = []
    for number, index in enumerate(ids[:MAX_LEVELS], 1):
        try:
            if index in ids[: number - 1]:
                raise FormatError(f"node {index} is another level already")
            levels.append((number, _level(container, graph, shown, scene, index)))
        except FormatError as error:
            left_out(log, f"level of detail {number} is left out: {error}")
    return _in_order(scene, levels)


def _in_order(scene: Scene, levels: list[tuple[int, Level[Any]]]) -> Scene:
    ordered = sorted(levels, key=lambda one: -len(splats_of(one[1].content)))
    if ordered != levels:
        left_out(log, "levels of detail are not in order; they are taken by their numbers of splats")
    kept: list[Level[Any]] = []
    count, density = len(splats_of(scene)), float("inf")
    for number, level in ordered:
        splats = len(splats_of(level.content))
        if splats >= count:
            left_out(log, f"level of detail {number} is left out: {splats} splats are not fewer than {count}")
        elif level.density >= density:
            reason = f"its density of {level.density:g} is not below the {density:g} of the finer level"
            left_out(log, f"level of detail {number} is left out: {reason}")
        else:
            kept.append(level)
            count, density = splats, level.density
    bare: Any = scene
    made: Scene = replace(bare, levels=tuple(kept))
    return made


def _level(container: Container, graph: Graph, shown: Instance, scene: Splats | Avatar, index: int) -> Level[Any]:
    """Read the level of a node. Raises FormatError, before reading arrays of a node that cannot be a level."""
    gltf = container.gltf
    if index < 0:
        raise FormatError(f"there is no node {index}")
    node = item(gltf.nodes, index, "node")
    if index == shown.index:
        raise FormatError(f"node {index} is the finest itself")
    primitives = [] if node.mesh is None else item(gltf.meshes, node.mesh, "mesh").primitives
    if len(primitives) != 1 or EXTENSION not in primitives[0].extensions:
        raise FormatError(f"node {index} needs a mesh with one primitive of splats ({EXTENSION})")
    ours = our_extras(node.extras)
    density = number_of(ours.get("density"))
    if density is None or density <= 0:
        raise FormatError("it has no density (pixels a metre, in the node's extras.glsplat)")
    primitive, name = primitives[0], f"mesh {node.mesh} primitive 0"
    most = len(splats_of(scene))
    if "POSITION" not in primitive.attributes:
        raise FormatError(f"{name}: splats need the attribute POSITION")
    count = item(gltf.accessors, primitive.attributes["POSITION"], "accessor of POSITION").count
    if not 0 < count < most:
        raise FormatError(f"{count} splats, the finest has {most}")
    above, world, parents = int(graph.parents[shown.index]), graph.world, graph.parents
    # without a parent it hangs from that of the finest
    matrix = world[index] if parents[index] >= 0 or above < 0 else world[above] @ world[index]
    instance = Instance(primitive, node, matrix, name, index)
    return Level(_content(container, graph, shown, scene, instance, ours), density, number_of(ours.get("psnr")))


def _content(
    container: Container,
    graph: Graph,
    shown: Instance,
    scene: Splats | Avatar,
    instance: Instance,
    ours: dict[str, Any],
) -> Splats | Avatar:
    rigged = instance.node.skin is not None and "JOINTS_0" in instance.primitive.attributes
    if rigged != isinstance(scene, Avatar):
        raise FormatError("it has a skin, the finest has none" if rigged else "it has no skin, the finest has one")
    splats = read_splats(container, instance.primitive, instance.name)
    if isinstance(ours.get(ANTIALIAS), bool):
        splats = replace(splats, antialias=ours[ANTIALIAS])
    if not isinstance(scene, Avatar):
        if np.array_equal(instance.matrix, shown.matrix):
            return splats
        try:
            with np.errstate(all="ignore"):
                placed = np.linalg.solve(shown.matrix, instance.matrix).astype(np.float64)
        except np.linalg.LinAlgError:
            raise FormatError("the finest has no valid place (a scale of zero?)") from None
        return transformed(splats, placed)
    same = instance.node.skin == shown.node.skin
    if not same and not read_skeleton(container, instance, graph).same(scene.skeleton):
        raise FormatError("it is bound to another skeleton than the finest")
    skin = read_skin(container, instance, len(scene.skeleton), len(splats), ours.get(SKIN_WEIGHTS))
    shapes = shapes_of(container, instance, len(splats))
    if shapes is not None and (scene.shapes is None or shapes.names != scene.shapes.names):
        raise FormatError("its morph targets are not called as those of the finest")
    return Avatar(splats, scene.skeleton, skin, scene.meta, shapes=shapes)
