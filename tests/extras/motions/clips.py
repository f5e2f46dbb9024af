"""glTF animations built in code: a humanoid whose nodes have rotations of their own at rest, as many files have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.formats.scenes import write_glb

# bone of VRM: parent, where it is in the T-pose, metres
BONES = {
    "hips": (None, (0, 0.95, 0)),
    "spine": ("hips", (0, 1.05, 0)),
    "chest": ("spine", (0, 1.2, 0)),
    "neck": ("chest", (0, 1.45, 0)),
    "head": ("neck", (0, 1.55, 0)),
}
for _side, _x in (("left", 1), ("right", -1)):
    BONES |= {
        f"{_side}UpperLeg": ("hips", (0.09 * _x, 0.9, 0)),
        f"{_side}LowerLeg": (f"{_side}UpperLeg", (0.09 * _x, 0.5, 0.01)),
        f"{_side}Foot": (f"{_side}LowerLeg", (0.09 * _x, 0.09, -0.01)),
        f"{_side}Toes": (f"{_side}Foot", (0.09 * _x, 0.02, 0.12)),
        f"{_side}Shoulder": ("chest", (0.04 * _x, 1.4, 0)),
        f"{_side}UpperArm": (f"{_side}Shoulder", (0.16 * _x, 1.4, 0)),
        f"{_side}LowerArm": (f"{_side}UpperArm", (0.43 * _x, 1.4, 0)),
        f"{_side}Hand": (f"{_side}LowerArm", (0.68 * _x, 1.4, 0)),
    }
NODES = list(BONES)
FRAMES = [Rotation.from_rotvec(np.random.default_rng(k).normal(0, 1, 3)) for k in range(len(NODES))]  # of the nodes


def turned(bone: str, world: Rotation) -> Rotation:
    """The local rotation of a node that turns its bone by ``world`` from the T-pose, its parent at rest."""
    k = NODES.index(bone)
    parent = BONES[bone][0]
    above = Rotation.identity() if parent is None else FRAMES[NODES.index(parent)]
    return above.inv() * world * FRAMES[k]


def glb(path: Path, animations: list[dict[str, Any]], vrm: bool = False, names: dict[str, str] | None = None) -> Path:
    """Write a .glb. An animation: {"name", "channels": [(bone, path, kind, times, values)]}; a bone, or a node."""
    blob, views, accessors = b"", [], []

    def add(values: Any) -> int:
        nonlocal blob
        data = np.ascontiguousarray(values, "<f4")
        kind = "SCALAR" if data.ndim == 1 else f"VEC{data.shape[1]}"
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": data.nbytes})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": len(data), "type": kind})
        blob += data.tobytes()
        return len(accessors) - 1

    nodes: list[dict[str, Any]] = []
    for k, (bone, (parent, place)) in enumerate(BONES.items()):
        above = np.zeros(3) if parent is None else np.array(BONES[parent][1])
        frame = Rotation.identity() if parent is None else FRAMES[NODES.index(parent)]
        node = {"name": (names or {}).get(bone, f"node {k}" if vrm else bone)}
        node |= {"translation": frame.inv().apply(np.array(place) - above).tolist()}
        node |= {"rotation": turned(bone, Rotation.identity()).as_quat().tolist()}
        nodes.append(node | {"children": [i for i, name in enumerate(NODES) if BONES[name][0] == bone]})
    written = []
    for animation in animations:
        channels, samplers = [], []
        for bone, kind, how, times, values in animation["channels"]:
            samplers.append({"input": add(times), "output": add(values), "interpolation": how})
            node = NODES.index(bone) if isinstance(bone, str) else bone
            channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": kind}})
        named = {"name": animation["name"]} if "name" in animation else {}
        written.append({"channels": channels, "samplers": samplers} | named)
    tree: dict[str, Any] = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": nodes}
    tree |= {
        "animations": written,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    if vrm:
        bones = {bone: {"node": k} for k, bone in enumerate(NODES)}
        tree["extensions"] = {"VRMC_vrm_animation": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
    return write(path, tree, blob)


def write(path: Path, tree: dict[str, Any], blob: bytes) -> Path:
    write_glb(path, tree, blob + b"\0" * (-len(blob) % 4))
    return path
