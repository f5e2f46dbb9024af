"""Read motion capture: Biovision BVH, and Acclaim ASF/AMC (a skeleton file and a motion file)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.motions.clip import Clip, chained, check_size
from glsplat.rotations import rotation_matrices

_Bone = dict[str, NDArray[np.float64] | list[str]]
_ACCLAIM_FPS = 120.0  # CMU's rate, which the file does not have
_MAX_JOINTS = 1024
_LONGEST = 8  # words of a name
_BLOCK = 1 << 20  # characters of numbers split at a time


def parse_bvh(text: str) -> Clip:
    """Parse a BVH file's text. Angles are in degrees, channels in the file's order (intrinsic rotations).

    Raises PoseError: malformed or truncated hierarchy or motion, no frames, non-finite numbers.
    """
    head, mark, tail = text.partition("MOTION")
    if not mark:
        raise PoseError("a BVH file needs a MOTION section, found none (truncated?)")
    names, parents, offsets, channels = _hierarchy(head.split())
    lines = tail.split("\n", 3)
    words = tail.split(None, 5)
    try:
        if words[0].lower() != "frames:" or words[2].lower() != "frame" or words[3].lower() != "time:":
            raise ValueError
        count, step = int(words[1]), float(words[4])
    except (ValueError, IndexError):
        raise PoseError(f'MOTION needs "Frames: N" and "Frame Time: S", found {" ".join(lines)[:40]!r}') from None
    if count < 1 or not 1e-5 < step < 1e3:
        raise PoseError(f"a motion needs at least one frame and a frame time in seconds, not {count} and {step:g}")
    width = sum(len(c) for c in channels)
    check_size(count, len(names))
    values = _numbers(words[5] if len(words) > 5 else "", count * width, f"{count} frames of {width} channels")
    if not np.isfinite(values).all():
        raise PoseError("the motion needs finite numbers, found NaN or infinity")
    return _clip_of_channels(names, parents, offsets, channels, values.reshape(count, width), 1 / step)


def _numbers(text: str, count: int, what: str) -> F64:
    """Parse ``count`` numbers of a text, a block at a time: a list of all words would take ten times the memory."""
    if count > (len(text) + 1) // 2:
        raise PoseError(f"{what} are {count} numbers, found at most {(len(text) + 1) // 2}")
    out, done, start = np.empty(count), 0, 0
    while start < len(text):
        end = min(start + _BLOCK, len(text))
        while end < len(text) and not text[end].isspace():
            end += 1
        try:
            block = np.array(text[start:end].split(), np.float64)
        except ValueError as error:
            raise PoseError(f"the motion holds numbers only, but {str(error)[:80]}") from None
        out[done : done + len(block)] = block[: count - done]
        done, start = done + len(block), end
    if done != count:
        raise PoseError(f"{what} are {count} numbers, found {done}")
    return out


def _hierarchy(words: list[str]) -> tuple[list[str], list[int], list[list[float]], list[list[str]]]:
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[list[str]] = []
    stack: list[int] = []  # joint of each open brace, -2 for an end site
    pending: int | None = None
    if not words or words[0].upper() != "HIERARCHY":
        raise PoseError("a BVH file begins with HIERARCHY")
    i = 1
    try:
        while i < len(words):
            word = words[i].upper()
            if word in ("ROOT", "JOINT"):
                parent = stack[-1] if stack else -1
                if parent == -2 or (parent == -1 and names):
                    raise PoseError(f"joint {words[i + 1]!r} has no parent; a BVH hierarchy has one root")
                name, end = [words[i + 1]], i + 2
                while words[end] != "{" and len(name) < _LONGEST:  # "Bip001 L Thigh"
                    name.append(words[end])
                    end += 1
                names.append(" ".join(name))
                parents.append(parent)
                offsets.append([0.0, 0.0, 0.0])
                channels.append([])
                pending = len(names) - 1
                i = end
            elif word == "END":
                pending = -2
                i += 2
            elif word == "{":
                if pending is None:
                    raise PoseError("the hierarchy opens a brace without a joint")
                stack.append(pending)
                pending = None
                i += 1
            elif word == "}":
                stack.pop()
                i += 1
            elif word == "OFFSET":
                if stack[-1] >= 0:
                    offsets[stack[-1]] = [float(v) for v in words[i + 1 : i + 4]]
                i += 4
            elif word == "CHANNELS":
                count = int(words[i + 1])
                channels[stack[-1]] = [c.lower() for c in words[i + 2 : i + 2 + count]]
                i += 2 + count
            else:
                raise PoseError(f"unexpected {words[i][:24]!r} in the hierarchy")
            if len(names) > _MAX_JOINTS:
                raise PoseError(f"more than {_MAX_JOINTS} joints in the hierarchy")
    except (IndexError, ValueError):
        raise PoseError("the hierarchy is malformed or truncated") from None
    known = {f"{axis}{kind}" for axis in "xyz" for kind in ("position", "rotation")}
    bad = [c for joint in channels for c in joint if c not in known]
    if stack or not names or bad or any(len(o) != 3 for o in offsets):
        raise PoseError(f"the hierarchy is truncated or has an unknown channel {bad[:1]}")
    return names, parents, offsets, channels


def _clip_of_channels(
    names: list[str],
    parents: list[int],
    offsets: list[list[float]],
    channels: list[list[str]],
    values: F64,
    fps: float,
) -> Clip:
    rest = np.array(offsets)
    rotations = np.tile(np.eye(3), (len(values), len(names), 1, 1))
    moved: dict[int, F64] = {}
    at = 0
    for i, joint in enumerate(channels):
        columns = {channel: values[:, at + k] for k, channel in enumerate(joint)}
        order = [c[0] for c in joint if c.endswith("rotation")]
        if order:
            angles = np.stack([columns[f"{axis}rotation"] for axis in order], axis=1)
            rotations[:, i] = _euler(order, angles)
        axes = [k for k, axis in enumerate("xyz") if f"{axis}position" in columns]
        if axes:
            moved[i] = np.tile(rest[i], (len(values), 1))
            moved[i][:, axes] = np.stack([columns[f"{'xyz'[k]}position"] for k in axes], axis=1)
        at += len(joint)
    below = [i for i in moved if i > 0]
    if _added(rest, moved, below):
        for i in below:
            moved[i] = np.where([f"{axis}position" in channels[i] for axis in "xyz"], moved[i] + rest[i], rest[i])
    else:  # offsets that are all zero do not describe the body: its channels do
        for i in below:
            rest[i] = rest[i] if rest[i].any() else np.median(moved[i], axis=0)
    return chained(names, np.array(parents, np.int32), rest, rotations, moved, fps)


def _added(rest: F64, moved: Mapping[int, F64], below: Sequence[int]) -> bool:
    """Return whether position channels below the root are added to the offset instead of replacing it.

    Most makers write the position (Bandai-Namco, Blender), which stays near the offset. Some write an increment
    (MakeHuman), which stays near zero. The file's bones vote by the median of their channels.
    """
    votes = 0
    for i in below:
        usual = np.median(moved[i], axis=0)
        size = float(np.linalg.norm(rest[i]))
        if size > 0:
            votes += int(np.sign(np.linalg.norm(usual - rest[i]) - np.linalg.norm(usual)))
    return votes > 0


def _euler(order: list[str], degrees: F64) -> F64:
    """Return R = R_first R_second R_third [T, 3, 3] (intrinsic), for any number of axes, repeats allowed."""
    out = np.tile(np.eye(3), (len(degrees), 1, 1))
    for k, axis in enumerate(order):
        out = out @ _about(axis, degrees[:, k])
    return out


def _about(axis: str, degrees: F64) -> F64:
    """Return rotations [..., 3, 3] about a coordinate axis."""
    return rotation_matrices(np.radians(degrees)[..., None] * np.eye(3)["xyz".index(axis.lower())])


def _fixed_axes(degrees: ArrayLike) -> F64:
    """Return rotations [..., 3, 3] by angles [..., 3] about the fixed axes x, then y, then z."""
    x, y, z = np.moveaxis(np.asarray(degrees, np.float64), -1, 0)
    return _about("z", z) @ _about("y", y) @ _about("x", x)


def parse_acclaim(skeleton: str, motion: str) -> Clip:
    """Parse the text of an .asf and an .amc file. Lengths stay in the file's unit; 120 frames a second (CMU).

    A bone turns by C M C^-1 with C its ``axis`` rotation and M the frame's angles, both fixed-axis x, y, z. Raises
    PoseError for malformed or truncated text.
    """
    try:
        bones, parent_of = _asf(skeleton)
        order = _topological(bones, parent_of)
    except (IndexError, ValueError, KeyError):
        raise PoseError("the .asf skeleton is malformed or truncated") from None
    frames = _amc(motion)
    index = {name: i for i, name in enumerate(order)}
    # a joint of ours is at the near end of its bone: the far end of the parent
    offsets = np.array([bones[parent_of[n]]["tip"] if n != "root" else np.zeros(3) for n in order])
    parents = np.array([index[parent_of[n]] if n != "root" else -1 for n in order], np.int32)
    check_size(len(frames), len(order))
    rotations = np.tile(np.eye(3), (len(frames), len(order), 1, 1))
    positions = np.zeros((len(frames), 3))
    for name in order:
        dof = bones[name]["dof"]
        if not dof:
            continue
        try:
            values = np.array([frame[name] for frame in frames], np.float64)
        except (KeyError, ValueError):
            raise PoseError(f"the .amc motion has a frame without all numbers of bone {name!r}") from None
        if values.ndim != 2 or values.shape[1] != len(dof) or not np.isfinite(values).all():
            raise PoseError(f"bone {name!r} needs {len(dof)} finite numbers a frame ({' '.join(dof)})")
        angles = np.zeros((len(frames), 3))
        for k, channel in enumerate(dof):
            if channel[0] == "r":
                angles[:, "xyz".index(channel[1])] = values[:, k]
            elif channel[0] == "t":
                positions[:, "xyz".index(channel[1])] = values[:, k]
        axis = _fixed_axes(bones[name]["axis"])
        turned = _fixed_axes(angles)
        rotations[:, index[name]] = axis @ turned @ axis.T
    return chained(order, parents, offsets, rotations, {0: positions}, _ACCLAIM_FPS)


def _asf(text: str) -> tuple[dict[str, _Bone], dict[str, str]]:
    bones: dict[str, _Bone] = {}
    parent_of: dict[str, str] = {}
    section = ""
    bone: _Bone = {}
    for line in text.splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            section = words[0].lower()
            if section == ":root":
                bones["root"] = {"tip": np.zeros(3), "axis": np.zeros(3), "dof": []}
            continue
        key = words[0].lower()
        if section == ":root":
            if key == "order":
                bones["root"]["dof"] = [w.lower() for w in words[1:]]
            elif key == "orientation":
                bones["root"]["axis"] = np.array(words[1:4], np.float64)
        elif section == ":bonedata":
            if key == "begin":
                bone = {"axis": np.zeros(3), "dof": []}
            elif key == "name":
                bones[words[1]] = bone
            elif key == "direction":
                bone["direction"] = np.array(words[1:4], np.float64)
            elif key == "length":
                bone["length"] = np.array(words[1], np.float64)
            elif key == "axis":
                bone["axis"] = np.array(words[1:4], np.float64)
            elif key == "dof":
                bone["dof"] = [w.lower() for w in words[1:]]
            elif key == "end":
                bone["tip"] = np.asarray(bone["direction"]) * np.asarray(bone["length"])
        elif section == ":hierarchy" and key not in ("begin", "end"):
            for child in words[1:]:
                parent_of[child] = words[0]
    return bones, parent_of


def _topological(bones: dict[str, _Bone], parent_of: dict[str, str]) -> list[str]:
    order = ["root"]
    while True:
        more = [child for child, parent in parent_of.items() if parent in order and child not in order]
        if not more:
            if len(order) != len(bones):
                raise KeyError("a bone without a place in the hierarchy")
            return order
        for child in more:
            bones[child]["tip"]
        order += more


def _amc(text: str) -> list[dict[str, list[float]]]:
    frames: list[dict[str, list[float]]] = []
    for line in text.splitlines():
        words = line.split()
        if not words or words[0][0] in "#:":
            if words and words[0].lower() == ":radians":
                raise PoseError("an .amc in radians is not supported; export it in degrees")
            continue
        if len(words) == 1 and words[0].isdigit():
            frames.append({})
        elif frames:
            try:
                frames[-1][words[0]] = [float(w) for w in words[1:]]
            except ValueError:
                raise PoseError(f"frame {len(frames)}: bone {words[0][:24]!r} needs numbers") from None
    if not frames:
        raise PoseError("the .amc motion has no frames")
    return frames


def skeleton_file(path: Path) -> Path:
    """Return the .asf in an .amc's folder with the longest name that the .amc's begins with (02.asf for 02_01.amc)."""
    fits = [p for p in sorted(path.parent.glob("*.asf")) if path.stem.startswith(p.stem)]
    if not fits:
        raise PoseError(f"{path}: needs its skeleton beside it, an .asf file whose name this one begins with")
    return max(fits, key=lambda p: len(p.stem))
