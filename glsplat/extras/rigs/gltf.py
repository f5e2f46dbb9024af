"""What a glTF file says of its rig: bind frames and names of joints, and the maps of VRM 0.x, 1.0 and animations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.rigs.match import spine_of
from glsplat.formats.gltf.container import Container
from glsplat.formats.gltf.nodes import Graph
from glsplat.formats.gltf.rig import inverse_binds
from glsplat.formats.gltf.schema import Gltf

_BONES = {"hips": "pelvis", "neck": "neck", "head": "head", "jaw": "jaw"}
_LIMBS = {
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot", "Shoulder": "collar",
    "UpperArm": "shoulder", "LowerArm": "elbow", "Hand": "wrist", "Eye": "eye_smplhf",
}  # fmt: skip
_FINGERS = {"Thumb": "thumb", "Index": "index", "Middle": "middle", "Ring": "ring", "Little": "pinky"}
_SPINE = ("spine", "chest", "upperChest")


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


def human_bones(gltf: Gltf) -> dict[str, int]:
    """Return SMPL-X joint -> node; empty for other files than VRM. Raises FormatError for a malformed map."""
    try:
        entries = _entries(gltf.extensions)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise FormatError("the humanoid map of the VRM is malformed") from None
    for bone, node in entries.items():
        if not 0 <= node < len(gltf.nodes):
            raise FormatError(
                f"the humanoid map of the VRM names node {node} as {bone[:30]}, the file has {len(gltf.nodes)}"
            )
    out = {ours: entries[theirs] for theirs, ours in _BONES.items() if theirs in entries}
    out |= spine_of([entries[name] for name in _SPINE if name in entries])
    for side in ("left", "right"):
        out |= {f"{side}_{ours}": entries[side + theirs] for theirs, ours in _LIMBS.items() if side + theirs in entries}
        for theirs, ours in _FINGERS.items():
            # 0.x names a thumb's bones as the other fingers', 1.0 starts with its metacarpal
            names = ("Metacarpal", "Proximal", "Intermediate", "Distal")
            bones = [entries[side + theirs + name] for name in names if side + theirs + name in entries]
            out |= {f"{side}_{ours}{place}": node for place, node in enumerate(bones[:3], 1)}
    return out


def face_binds(gltf: Gltf) -> dict[str, list[tuple[int | None, int | None, int, float]]]:
    """Return expression -> (node, or mesh, number of the morph target, weight from 0 to 1) of each target it moves.

    VRM 1.0 names nodes, VRM 0.x meshes. A malformed list is ignored, as expressions are optional.
    """
    out: dict[str, list[tuple[int | None, int | None, int, float]]] = {}
    try:
        found = gltf.extensions.get("VRMC_vrm", {}).get("expressions") or {}
        for kind in ("custom", "preset"):
            for name, expression in (found.get(kind) or {}).items():
                binds = expression.get("morphTargetBinds") or []
                out[str(name)] = [(int(b["node"]), None, int(b["index"]), float(b["weight"])) for b in binds]
        for group in gltf.extensions.get("VRM", {}).get("blendShapeMaster", {}).get("blendShapeGroups", []):
            binds = group.get("binds") or []
            of = [(None, int(b["mesh"]), int(b["index"]), float(b["weight"]) / 100) for b in binds]
            out[str(group.get("name"))] = [*of]
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError):
        return {}
    return {name: binds for name, binds in out.items() if binds and all(abs(weight) < 1e3 for *_, weight in binds)}


def _entries(extensions: dict[str, Any]) -> dict[str, int]:
    """Return bone -> node."""
    for name in ("VRMC_vrm", "VRMC_vrm_animation"):
        if name in extensions:
            bones = extensions[name]["humanoid"]["humanBones"]
            return {str(bone): int(entry["node"]) for bone, entry in bones.items()}
    if "VRM" in extensions:
        return {
            str(e["bone"]): int(e["node"])
            for e in extensions["VRM"]["humanoid"]["humanBones"]
            if e.get("node", -1) >= 0
        }
    return {}
