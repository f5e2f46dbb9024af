"""A motion-capture clip on a skeleton of its own, and its retargeting to the 55 joints of SMPL-X."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import PoseError
from glsplat.rotations import matrix_quaternions, quaternion_vectors, rotation_between, rotation_matrices
from glsplat.skinning.rigs.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["Clip", "retarget"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """T frames of S joints. In the rest pose all rotations are the identity in the file's own world."""

    names: tuple[str, ...]
    parents: NDArray[np.int32]  # [S] parents come first, -1 for the root
    offsets: F64  # [S, 3] rest position in the parent's frame, any unit
    rotations: F64  # [T, S, 3, 3] local
    positions: F64  # [T, 3] of the root, in the same unit
    fps: float
    _global: F64 = field(init=False, repr=False)  # [T, S, 3, 3]

    def __post_init__(self) -> None:
        out = np.array(self.rotations)
        for i, parent in enumerate(self.parents):
            if parent >= 0:
                out[:, i] = out[:, parent] @ self.rotations[:, i]
        object.__setattr__(self, "_global", out)

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def rest(self) -> F64:
        """[S, 3] rest positions with the root at the origin."""
        out = np.zeros_like(self.offsets)
        for i, parent in enumerate(self.parents):
            if parent >= 0:
                out[i] = out[parent] + self.offsets[i]
        return out

    @property
    def global_rotations(self) -> F64:
        """[T, S, 3, 3]"""
        return self._global


# Which joint of a file moves which of ours; the first name found counts. Names are compared without case, prefix
# ("mixamorig:") and punctuation. "#" stands for the side: left/right, l/r before or after the name. Where a file splits
# a bone (MakeHuman's twist bones, CMU's wrist and hand), the last piece comes first: its rotation holds the others.
_SIDED: dict[str, tuple[str, ...]] = {
    "hip": ("upperleg02#", "upperleg01#", "#upleg", "#hip", "#thigh", "#femur", "upperleg#", "thigh#", "#upperleg"),
    "knee": ("lowerleg02#", "lowerleg01#", "#leg", "#knee", "#shin", "#tibia", "lowerleg#", "shin#", "calf#", "#calf"),
    "ankle": ("foot#", "#foot", "#ankle"),
    "foot": ("toe11#", "#toebase", "#toe", "#toes", "toes#", "toe#"),
    "collar": ("shoulder01#", "clavicle#", "#collar", "#clavicle", "#shoulder", "shoulder#"),
    "shoulder": ("upperarm02#", "upperarm01#", "#arm", "#humerus", "#uparm", "upperarm#", "#upperarm", "#shoulder"),
    "elbow": ("lowerarm02#", "lowerarm01#", "#forearm", "#elbow", "#radius", "lowerarm#", "forearm#", "#lowarm"),
    "wrist": ("wrist#", "#hand", "hand#", "#wrist"),
    **{f"index{i}": (f"finger2{i}#", f"#handindex{i}", f"#index{i}") for i in (1, 2, 3)},
    **{f"middle{i}": (f"finger3{i}#", f"#handmiddle{i}", f"#middle{i}") for i in (1, 2, 3)},
    **{f"ring{i}": (f"finger4{i}#", f"#handring{i}", f"#ring{i}") for i in (1, 2, 3)},
    **{f"pinky{i}": (f"finger5{i}#", f"#handpinky{i}", f"#pinky{i}", f"#little{i}") for i in (1, 2, 3)},
    **{f"thumb{i}": (f"finger1{i}#", f"#handthumb{i}", f"#thumb{i}") for i in (1, 2, 3)},
}
_SINGLE: dict[str, tuple[str, ...]] = {
    "pelvis": ("hips", "hip", "pelvis", "root"),
    "spine1": ("spine04", "lowerback", "spine", "spine1", "chest"),
    "spine2": ("spine03", "upperback", "spine1", "spine2", "chest"),
    "spine3": ("spine01", "thorax", "upperchest", "chest2", "spine2", "spine3", "chest", "spine1"),
    "neck": ("neck03", "upperneck", "neck1", "neck", "neck01", "lowerneck"),
    "head": ("head",),
    "jaw": ("jaw",),
}
_NEEDED = (
    "pelvis",
    *(f"{side}_{joint}" for joint in ("hip", "knee", "shoulder", "elbow") for side in ("left", "right")),
)

# a bone's direction in the rest pose: from the joint to this one
_TOWARD = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
_FOLLOWS = {"wrist": "elbow", "ankle": "knee", "foot": "ankle"}  # takes over the other's correction


def retarget(clip: Clip, skeleton: Skeleton, *, forward: bool = False) -> tuple[F64, F64]:
    """Rotations [T, 55, 3] (axis-angle) and translations [T, 3] (metres) of ``clip`` on an SMPL-X rig.

    Each joint takes the global rotation of its namesake, corrected by the rotation between the rest directions of the
    two bones, so that rest poses may differ (arms down against T). Lengths are scaled by the legs, so any unit will do;
    the clip begins above the origin and its lowest foot is on the floor. ``forward`` turns it to face +z at frame 0.
    Joints the file does not have stay at rest. Raises PoseError when needed joints are not found.
    """
    if why := why_not_driven(skeleton):
        raise PoseError(f"motion capture cannot drive this avatar: {why}")
    found = _match(clip.names)
    missing = [name for name in _NEEDED if name not in found]
    if missing:
        raise PoseError(f"no joint for {', '.join(missing[:4])} among {', '.join(clip.names[:8])}, ...")
    index = {name: i for i, name in enumerate(JOINT_NAMES)}
    upright = _upright(clip, found)
    rest, joints = clip.rest @ upright.T, skeleton.joints
    moved = upright @ clip.global_rotations @ upright.T
    corrections = _corrections(rest, joints, found, index)

    goal = np.empty((len(clip), len(JOINT_NAMES), 3, 3))
    local = np.tile(np.eye(3), (len(clip), len(JOINT_NAMES), 1, 1))
    for i, name in enumerate(JOINT_NAMES):
        parent = int(skeleton.parents[i])
        above = goal[:, parent] if parent >= 0 else np.eye(3)[None]
        if name in found:
            goal[:, i] = moved[:, found[name]] @ corrections.get(name, np.eye(3))
            local[:, i] = np.swapaxes(above, -1, -2) @ goal[:, i]
        else:
            goal[:, i] = above
    scale = _leg(joints, index) / max(_leg(rest, found), 1e-9)
    root = clip.positions @ upright.T * scale
    if forward:
        turn = _facing(local[0, 0])
        local[:, 0] = turn @ local[:, 0]
        root = root @ turn.T
    trans = root - root[0] * (1, 0, 1) - joints[0] * (0, 1, 0)
    return quaternion_vectors(matrix_quaternions(local)), trans


def _match(names: tuple[str, ...]) -> dict[str, int]:
    """Our joint name -> index in the file."""
    index: dict[str, int] = {}
    for i, name in enumerate(names):
        index.setdefault(re.sub(r"[^a-z0-9]", "", name.rsplit(":", 1)[-1].lower()), i)
    found: dict[str, int] = {}
    taken: set[int] = set()

    def take(target: str, candidates: list[str]) -> None:
        for candidate in candidates:
            i = index.get(candidate)
            if i is not None and i not in taken:
                found[target] = i
                taken.add(i)
                return

    # arms from the hand inwards: in some files "shoulder" is the collar, in others the upper arm
    for side, short in (("left", "l"), ("right", "r")):
        collar_first = any(
            s + n in index for s in (side, short) for n in ("arm", "humerus", "uparm", "upperarm")
        ) or any(n + short in index for n in ("upperarm", "upperarm01"))
        for joint, patterns in _SIDED.items():
            usable = patterns
            if joint == "collar" and not collar_first:
                usable = tuple(p for p in patterns if "shoulder" not in p)
            forms = [p.replace("#", s) for p in usable for s in (side, short)]
            take(f"{side}_{joint}", forms)
    for joint, patterns in _SINGLE.items():
        take(joint, list(patterns))
    return found


def _upright(clip: Clip, found: dict[str, int]) -> F64:
    """[3, 3] rotation by right angles from the file's axes to (x left, y up, z forward), seen at rest."""
    rest = clip.rest
    left = rest[found["left_hip"]] - rest[found["right_hip"]]
    up = rest[found["pelvis"]] - (rest[found["left_knee"]] + rest[found["right_knee"]]) / 2
    if np.linalg.norm(left) < 1e-9 or np.linalg.norm(up) < 1e-9:
        raise PoseError("the rest pose has no size: hips and knees coincide")
    x = np.zeros(3)
    x[np.abs(left).argmax()] = np.sign(left[np.abs(left).argmax()])
    up = up - x * (up @ x)
    y = np.zeros(3)
    y[np.abs(up).argmax()] = np.sign(up[np.abs(up).argmax()])
    return np.stack([x, y, np.cross(x, y)])


def _corrections(rest: F64, joints: F64, found: dict[str, int], index: dict[str, int]) -> dict[str, F64]:
    out: dict[str, F64] = {}
    for side in ("left", "right"):
        for joint, child in _TOWARD.items():
            a, b = f"{side}_{joint}", f"{side}_{child}"
            if a in found and b in found:
                ours = joints[index[b]] - joints[index[a]]
                theirs = rest[found[b]] - rest[found[a]]
                out[a] = rotation_between(ours, theirs)
        for joint, model in _FOLLOWS.items():
            if f"{side}_{model}" in out:
                out[f"{side}_{joint}"] = out[f"{side}_{model}"]
        # a foot keeps its sole as it is: only the sideways tilt of the shin goes with it
        knee, ankle = f"{side}_knee", f"{side}_ankle"
        if knee in found and ankle in found:
            theirs = (rest[found[ankle]] - rest[found[knee]]) * (1, 1, 0)
            out[ankle] = out[f"{side}_foot"] = rotation_between(np.array([0.0, -1.0, 0.0]), theirs)
        for finger in ("index", "middle", "ring", "pinky", "thumb"):
            for i in (1, 2, 3):
                if f"{side}_wrist" in out:
                    out[f"{side}_{finger}{i}"] = out[f"{side}_wrist"]
    return out


def _leg(points: F64, index: dict[str, int]) -> float:
    total = 0.0
    for side in ("left", "right"):
        hip, knee = points[index[f"{side}_hip"]], points[index[f"{side}_knee"]]
        ankle = points[index[f"{side}_ankle"]] if f"{side}_ankle" in index else 2 * knee - hip
        total += float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)) / 2
    return total


def _facing(root: F64) -> F64:
    """[3, 3] turn about y that makes a root rotation face +z."""
    ahead = root[:, 2]
    angle = -np.arctan2(ahead[0], ahead[2])
    return rotation_matrices([0, angle, 0])
