"""A second reader of motions, for tests: positions by 4x4 matrices, straight from what the formats define.

Nothing of glsplat.motion is used. BVH: M_joint = M_parent T(offset or position channels) R_1 R_2 R_3 in order of the
channels. glTF 2.0: M_node = M_parent T R S with the animation's samplers (3.11, appendix C). Acclaim: as CMU writes it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from tests.formats.scenes import glb_parts


def bvh_positions(path: Path, every: int = 1, added: bool = False) -> tuple[dict[str, np.ndarray], float]:
    """Joint -> [T, 3] where it is in the file's world, of every n-th frame; and seconds between frames of the file.

    ``added``: position channels below the root are added to the offset (MakeHuman, three.js), not in its place.
    """
    words = path.read_text(encoding="latin-1").split()
    at, stack, joints = 0, [], []  # joints: name, parent, offset, channels
    while words[at] != "MOTION":
        if words[at] in ("ROOT", "JOINT"):
            joints.append([words[at + 1], stack[-1] if stack else None, None, []])
            new, at = len(joints) - 1, at + 2
        elif words[at] == "End":
            new, at = None, at + 2
        elif words[at] == "{":
            stack.append(new)
            at += 1
        elif words[at] == "}":
            stack.pop()
            at += 1
        elif words[at] == "OFFSET":
            if stack[-1] is not None:
                joints[stack[-1]][2] = [float(v) for v in words[at + 1 : at + 4]]
            at += 4
        elif words[at] == "CHANNELS":
            count = int(words[at + 1])
            joints[stack[-1]][3] = words[at + 2 : at + 2 + count]
            at += 2 + count
        else:
            at += 1
    count, step = int(words[at + 2]), float(words[at + 5])
    rows = np.array(words[at + 6 :], float).reshape(count, -1)[::every]
    out: dict[str, list] = {name: [] for name, *_ in joints}
    for row in rows:
        worlds, column = [], 0
        for name, parent, offset, channels in joints:
            local = np.eye(4)
            local[:3, 3] = offset
            for channel in channels:
                value, axis = row[column], "xyz".index(channel[0].lower())
                column += 1
                if channel.lower().endswith("position"):
                    local[axis, 3] = value + (offset[axis] if added and parent is not None else 0)
                else:
                    turn = np.eye(4)
                    turn[:3, :3] = Rotation.from_euler("xyz"[axis], value, degrees=True).as_matrix()
                    local = local @ turn
            worlds.append(local if parent is None else worlds[parent] @ local)
            out[name].append(worlds[-1][:3, 3])
    return {name: np.array(rows) for name, rows in out.items()}, step


def acclaim_positions(skeleton: Path, motion: Path, every: int = 1) -> dict[str, np.ndarray]:
    """Bone -> [T, 3] its near end: that is our joint. Columns are x y z fixed-axis angles in the bone's own axes."""
    bones, parents, bone = {"root": {"dof": "tx ty tz rx ry rz".split(), "axis": [0, 0, 0], "tip": np.zeros(3)}}, {}, {}
    section = ""
    for line in skeleton.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        section = words[0] if words[0].startswith(":") else section
        if section == ":bonedata":
            if words[0] == "begin":
                bone = {"dof": []}
            elif words[0] == "end":
                bones[bone["name"]] = bone
            elif words[0] in ("direction", "axis"):
                bone[words[0]] = [float(v) for v in words[1:4]]
            elif words[0] == "length":
                bone["tip"] = np.array(bone["direction"]) * float(words[1])
            elif words[0] == "dof":
                bone["dof"] = words[1:]
            elif words[0] == "name":
                bone["name"] = words[1]
        elif section == ":hierarchy" and words[0] not in ("begin", "end", ":hierarchy"):
            parents |= dict.fromkeys(words[1:], words[0])
    frames: list[dict[str, list[float]]] = []
    for line in motion.read_text().splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif frames:
            frames[-1][words[0]] = [float(v) for v in words[1:]]

    def world(name: str, frame: dict[str, list[float]]) -> tuple[np.ndarray, np.ndarray]:
        """Near end and rotation of a bone."""
        value = dict(zip(bones[name]["dof"], frame.get(name, ()), strict=False))
        axis = Rotation.from_euler("xyz", bones[name]["axis"], degrees=True).as_matrix()
        turn = Rotation.from_euler("xyz", [value.get(f"r{a}", 0.0) for a in "xyz"], degrees=True).as_matrix()
        local = axis @ turn @ axis.T
        if name == "root":
            return np.array([value[f"t{a}"] for a in "xyz"]), local
        place, above = world(parents[name], frame)
        return place + above @ bones[parents[name]]["tip"], above @ local

    return {name: np.array([world(name, frame)[0] for frame in frames[::every]]) for name in bones}


def accessor(tree: dict, blob: bytes, index: int) -> np.ndarray:
    entry = tree["accessors"][index]
    view = tree["bufferViews"][entry["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[entry["type"]]
    kind = {5126: "<f4", 5122: "<i2", 5120: "i1"}[entry["componentType"]]
    start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
    values = np.frombuffer(blob, kind, entry["count"] * width, start).reshape(-1, width).astype(float)
    return values if kind == "<f4" else np.maximum(values / {"<i2": 32767, "i1": 127}[kind], -1)


def gltf_positions(path: Path, times: np.ndarray, animation: int = 0) -> list[np.ndarray]:
    """Node -> [T, 3] in the world at ``times`` (seconds of the file); linear samplers only."""
    tree, blob = glb_parts(path.read_bytes())
    moved = {}
    for channel in tree["animations"][animation]["channels"]:
        sampler = tree["animations"][animation]["samplers"][channel["sampler"]]
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        keys, values = (accessor(tree, blob, sampler[name]) for name in ("input", "output"))
        keys = keys[:, 0]
        t = np.clip(times, keys[0], keys[-1])
        place = channel["target"].get("node"), channel["target"]["path"]
        if place[1] == "rotation":
            turns = Rotation.from_quat(values)
            moved[place] = (turns if len(keys) == 1 else Slerp(keys, turns)(t)).as_matrix() + np.zeros((len(t), 3, 3))
        elif place[1] != "weights":
            moved[place] = np.stack([np.interp(t, keys, column) for column in values.T], 1)
    parents = {child: i for i, node in enumerate(tree["nodes"]) for child in node.get("children", ())}
    done: dict[int, np.ndarray] = {}

    def world(index: int) -> np.ndarray:
        if index not in done:
            node, local = tree["nodes"][index], np.tile(np.eye(4), (len(times), 1, 1))
            if "matrix" in node:
                local[:] = np.array(node["matrix"]).reshape(4, 4).T
            else:
                turn = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix()
                scale = moved.get((index, "scale"), np.array(node.get("scale", [1, 1, 1])))
                local[:, :3, :3] = moved.get((index, "rotation"), turn) * scale.reshape(-1, 1, 3)
                local[:, :3, 3] = moved.get((index, "translation"), node.get("translation", [0, 0, 0]))
            done[index] = world(parents[index]) @ local if index in parents else local
        return done[index]

    return [world(index)[:, :3, 3] for index in range(len(tree["nodes"]))]
