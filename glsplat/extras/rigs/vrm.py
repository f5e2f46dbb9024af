"""VRM 0.x and 1.0, and VRM animations: the file's own map from bones of a human to nodes."""

from __future__ import annotations

from typing import Any

from glsplat.errors import FormatError
from glsplat.extras.rigs.match import spine_of
from glsplat.formats.gltf.schema import Gltf

_BONES = {"hips": "pelvis", "neck": "neck", "head": "head", "jaw": "jaw"}
_LIMBS = {
    "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "ankle", "Toes": "foot", "Shoulder": "collar",
    "UpperArm": "shoulder", "LowerArm": "elbow", "Hand": "wrist", "Eye": "eye_smplhf",
}  # fmt: skip
_FINGERS = {"Thumb": "thumb", "Index": "index", "Middle": "middle", "Ring": "ring", "Little": "pinky"}
_SPINE = ("spine", "chest", "upperChest")


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
