"""A known motion written as BVH in the conventions of many exporters, with none of glsplat.motion's own code.

A joint's frame in the file is W K: W its rotation in the world of the known motion (identity in the T-pose), K constant
and the exporter's own: which pose is the file's rest pose, and along which axis its bones lie there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from glsplat.formats.motion_files import load_motion
from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

F64 = NDArray[np.float64]
AT = {name: i for i, name in enumerate(JOINT_NAMES)}
SIDES = ("left", "right")
BODY = [name for name in JOINT_NAMES[:22]]
FEET = [AT[f"{side}_{part}"] for side in SIDES for part in ("ankle", "foot")]
# what a bone points to, of those that several hang from
TOWARD = {"pelvis": "spine1", "spine3": "neck"}
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up to z up, facing -y


@dataclass(frozen=True)
class Export:
    """What an exporter does; names are SMPL-X joint -> the file's."""

    names: Mapping[str, str] = field(default_factory=dict)
    drop: tuple[str, ...] = ()  # joints that its skeleton does not have
    unit: float = 100.0  # per metre
    world: F64 = field(default_factory=lambda: np.eye(3))  # its axes
    order: str = "ZXY"  # of rotation channels
    rest: str = "T"  # T, A (arms 50 degrees down), x (bones along x), x- (the right side's along -x)
    root: str = ""  # a joint above the hips, at the origin
    hips: str = "position"  # channels below the root: none, position, added
    channels: str = "none"  # of the other joints: none, position, added
    offsets: bool = True  # False: all zero
    ends: bool = True  # End Site

    def text(self, motion: Motion, skeleton: Skeleton) -> str:
        """The file."""
        worlds = np.array([skeleton.forward(r, t) for r, t in zip(motion.rotations, motion.trans, strict=True)])
        keep = [name for name in BODY if name not in self.drop]
        parent = {name: self._parent(name) for name in keep}
        places = {n: worlds[:, AT[n], :3, 3] @ self.world.T * self.unit for n in keep}
        own = {n: self.world @ self._own(n, parent, skeleton.joints) for n in keep}
        turns = {n: self.world @ worlds[:, AT[n], :3, :3] @ self.world.T @ own[n] for n in keep}
        lines, numbers = ["HIERARCHY"], []

        def number(values: F64) -> None:
            numbers.append(np.broadcast_to(values, (len(worlds), 3)))

        def open_joint(word: str, name: str, offset: F64, channels: str) -> None:
            lines.append(f"{word} {name}\n{{\nOFFSET {' '.join(f'{v:.6f}' for v in offset)}")
            places = "Xposition Yposition Zposition " if channels != "none" else ""
            turned = " ".join(f"{axis}rotation" for axis in self.order)
            lines.append(f"CHANNELS {6 if places else 3} {places}{turned}")

        def emit(name: str) -> None:
            above = parent[name]
            if above is None:
                zero, place = np.zeros(3), places[name]
                offset = zero if not self.offsets else place[0] if self.root else zero
                kind = "position" if not self.root else self.hips
                local, turned = place, turns[name]
            else:
                offset = own[above].T @ self.world @ (skeleton.joints[AT[name]] - skeleton.joints[AT[above]])
                offset, kind = offset * self.unit, self.channels
                local, turned = offset[None], np.swapaxes(turns[above], 1, 2) @ turns[name]
            written = offset if self.offsets else np.zeros(3)
            open_joint("JOINT" if self.root or above else "ROOT", self.names.get(name, name), written, kind)
            if kind != "none":
                number(local - (written if kind == "added" else 0))
            number(Rotation.from_matrix(turned).as_euler(self.order, degrees=True))
            below = [n for n in keep if parent[n] == name]
            for child in below:
                emit(child)
            if not below and self.ends:
                lines.append("End Site\n{\nOFFSET 5 0 0\n}")
            lines.append("}")

        if self.root:
            open_joint("ROOT", self.root, np.zeros(3), "position")
            number(np.zeros(3))
            number(np.zeros(3))
        emit(keep[0])
        if self.root:
            lines.append("}")
        rows = np.concatenate(numbers, axis=1)
        head = f"MOTION\nFrames: {len(rows)}\nFrame Time: {1 / motion.fps:.6f}\n"
        return "\n".join(lines) + "\n" + head + "\n".join(" ".join(f"{v:.6f}" for v in row) for row in rows) + "\n"

    def _parent(self, name: str) -> str | None:
        at = int(PARENTS[AT[name]])
        while at >= 0 and JOINT_NAMES[at] in self.drop:
            at = int(PARENTS[at])
        return JOINT_NAMES[at] if at >= 0 else None

    def _own(self, name: str, parent: Mapping[str, str | None], joints: F64) -> F64:
        """[3, 3] K of a joint, before the world's axes are changed."""
        if self.rest == "A" and name.split("_")[-1] in ("shoulder", "elbow", "wrist"):
            angle = np.radians(50 if name.startswith("left") else -50)
            return Rotation.from_rotvec([0, 0, angle]).as_matrix() @ self.world.T
        if self.rest in ("T", "A"):
            return self.world.T
        below = TOWARD.get(name) or next((n for n in parent if parent[n] == name), None)
        if below in self.drop or below not in parent:
            below = next((n for n in parent if parent[n] == name), None)
        bone = joints[AT[below]] - joints[AT[name]] if below else joints[AT[name]] - joints[AT[parent[name]]]
        x = bone / np.linalg.norm(bone) * (-1 if self.rest == "x-" and name.startswith("right") else 1)
        z = np.cross(x, [0.2, 0.3, 0.93])
        z /= np.linalg.norm(z)
        return np.stack([x, np.cross(z, x), z], axis=1)


def walking(skeleton: Skeleton, heading: float = 0.5, frames: int = 90) -> Motion:
    """The embedded walk, which is on the spot, walking on: as fast as the foot that stands goes back. Radians."""
    walk = load_motion("walk", skeleton)
    index = np.arange(frames) % len(walk)
    rotations, trans = walk.rotations[index].copy(), walk.trans[index].copy()
    feet = np.array([skeleton.forward(r, t)[FEET, :3, 3] for r, t in zip(rotations, trans, strict=True)])
    low = feet[:-1, :, 1].argmin(axis=1)
    back = np.diff(feet, axis=0)[np.arange(frames - 1), low, 2]
    trans[:, 2] += np.arange(frames) * -float(np.median(back))
    turn = Rotation.from_rotvec([0, heading, 0])
    rotations[:, 0] = (turn * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    trans = turn.apply(trans + skeleton.joints[0]) - skeleton.joints[0]
    return Motion(walk.fps, rotations, trans)


def turned(motion: Motion, skeleton: Skeleton, turn: F64, *, body: bool = True, path: bool = True) -> Motion:
    """Body, path or both about the first place of the pelvis."""
    rotations = motion.rotations.copy()
    if body:
        rotations[:, 0] = (Rotation.from_matrix(turn) * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    start = motion.trans[0] * (1, 0, 1)
    trans = start + (motion.trans - start + skeleton.joints[0]) @ turn.T - skeleton.joints[0] if path else motion.trans
    return Motion(motion.fps, rotations, trans)
