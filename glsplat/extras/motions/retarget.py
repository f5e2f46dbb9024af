"""Retarget a clip of any skeleton to the 55 joints of SMPL-X."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.motions.clip import Clip
from glsplat.extras.motions.standing import flat_soles, standing
from glsplat.extras.rigs.humanoid import t_pose_turns
from glsplat.extras.rigs.match import RigMap, match_rig
from glsplat.extras.rigs.words import word_of
from glsplat.motion.fitted import leg_length
from glsplat.rotations import matrix_quaternions, quaternion_vectors, rotation_matrices
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_AT = {name: i for i, name in enumerate(JOINT_NAMES)}
_RIGID = 0.1  # of a bone: change of length that skins and capture systems cause
_SIDES = ("left", "right")
# joints along each limb; a bone that a file splits ends where the next of these begins
_CHAINS = (
    ("spine1", "spine2", "spine3", "neck", "head"),
    *(tuple(f"{side}_{part}" for part in ("hip", "knee", "ankle", "foot")) for side in _SIDES),
    *(tuple(f"{side}_{part}" for part in ("collar", "shoulder", "elbow", "wrist")) for side in _SIDES),
)
# bones that point exactly as the file's do
_BONES = {
    f"{side}_{above}": f"{side}_{below}"
    for side in _SIDES
    for above, below in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
}


def retarget(
    clip: Clip,
    skeleton: Skeleton,
    *,
    forward: bool = False,
    world: F64 | None = None,  # [3, 3] another rotation of the world in which they move
    swapped: bool = False,  # the clip's left is right
) -> tuple[F64, F64]:
    """Return rotations [T, 55, 3] (axis-angle) and translations [T, 3] (metres) of ``clip`` on an SMPL-X rig.

    Joints are matched by name (extras/rigs). Each turns as its match does, from a rest pose in which the bones of both
    are parallel, so that rest poses may differ (arms down against T). A bone that a file splits turns as its last piece
    and points from its first end to its last. Soles of standing feet are flat. Lengths are scaled by the legs, so any
    unit will do; the middle of the hips follows the file's and starts above the origin. ``forward`` turns the clip to
    face +z at frame 0. Missing joints stay at rest. Raises PoseError if needed joints are not found, and for animals.
    """
    if why := why_not_driven(skeleton):
        raise PoseError(f"motion capture cannot drive this avatar: {why}")
    stood = standing(clip, swapped=swapped)
    if world is not None:
        stood = replace(stood, world=world @ stood.world)
    clip, at = stood.clip, stood.map.joints
    rest, joints = clip.rest @ stood.rest.T, skeleton.joints
    to_t_pose = t_pose_turns({name: rest[index] for name, index in at.items()}, joints)
    pieces = _last_pieces(stood.map, clip)

    goal = np.empty((len(clip), len(JOINT_NAMES), 3, 3))
    vectors = np.zeros((len(clip), len(JOINT_NAMES), 3))
    for i, name in enumerate(JOINT_NAMES):
        parent = int(skeleton.parents[i])
        if name not in pieces:
            goal[:, i] = goal[:, parent]  # the pelvis is never missing
            continue
        goal[:, i] = stood.world @ clip.turns[:, pieces[name]] @ (stood.rest.T @ to_t_pose[name].T)
        if name in _BONES and _BONES[name] in at:
            along = (clip.places[:, at[_BONES[name]]] - clip.places[:, at[name]]) @ stood.world.T
            goal[:, i] = _pointed(goal[:, i], joints[_AT[_BONES[name]]] - joints[i], along)
    for side in _SIDES:
        ankle, toes = _AT[f"{side}_ankle"], _AT[f"{side}_foot"]
        flat = flat_soles(stood, goal[:, ankle], side)
        goal[:, ankle] = goal[:, ankle] @ flat
        goal[:, toes] = goal[:, toes] @ flat
    for i in range(len(JOINT_NAMES)):
        parent = int(skeleton.parents[i])
        above = goal[:, parent] if parent >= 0 else np.eye(3)[None]
        vectors[:, i] = quaternion_vectors(matrix_quaternions(np.swapaxes(above, -1, -2) @ goal[:, i]))

    middle = np.mean([joints[_AT[f"{side}_hip"]] for side in _SIDES], axis=0) - joints[0]
    hips = np.mean([clip.places[:, at[f"{side}_hip"]] for side in _SIDES], axis=0) @ stood.world.T
    trans = hips * (leg_length(joints) / max(_leg(rest, at), 1e-9)) - goal[:, 0] @ middle - joints[0]
    if forward:
        ahead = _facing(goal[0, 0])
        vectors[:, 0] = quaternion_vectors(matrix_quaternions(ahead @ goal[:, 0]))
        trans = (trans + joints[0]) @ ahead.T - joints[0]
    return vectors, trans - trans[0] * (1, 0, 1)


def stretched(clip: Clip) -> str:
    """Return a note on bones whose length changes, which an avatar's do not; "" if none does."""
    at, most = match_rig(clip.names, clip.parents, clip.rest, clip.given).joints, 0.0
    for above, below in _BONES.items():
        if above in at and below in at:
            sizes = np.linalg.norm(clip.places[:, at[below]] - clip.places[:, at[above]], axis=1)
            most = max(most, float(np.abs(sizes / max(float(np.median(sizes)), 1e-12) - 1).max()))
    return f"its limbs change their length by {100 * most:.0f} %, an avatar's keep theirs" if most > _RIGID else ""


def _pointed(turns: F64, bone: F64, along: F64) -> F64:
    """Turn ``turns`` [T, 3, 3] by the least angle so that ``bone`` [3] points ``along`` [T, 3]."""
    is_ = turns @ (bone / max(float(np.linalg.norm(bone)), 1e-12))
    sizes = np.linalg.norm(along, axis=1, keepdims=True)
    to = np.where(sizes > 1e-9, along / np.maximum(sizes, 1e-12), is_)
    axis = np.cross(is_, to)
    sin, cos = np.linalg.norm(axis, axis=1), np.einsum("ti,ti->t", is_, to)
    angle = np.where(cos > -0.999, np.arctan2(sin, cos), 0.0)  # opposite directions have no axis
    return np.asarray(rotation_matrices(axis * (angle / np.maximum(sin, 1e-12))[:, None]) @ turns)


def _last_pieces(found: RigMap, clip: Clip) -> dict[str, int]:
    """Return SMPL-X joint -> last piece of its bone: MakeHuman's upperleg02, Daz's thigh twist, CMU's hand."""
    out = dict(found.joints)
    for chain in _CHAINS:
        there = [name for name in chain if name in found.joints]
        for name, following in pairwise(there):
            last = at = int(clip.parents[found.joints[following]])
            while at >= 0 and at != found.joints[name]:
                at = int(clip.parents[at])
            out[name] = last if at >= 0 else found.joints[name]
    for side in _SIDES:  # several bones continue from a hand: its name identifies it
        wrist = found.joints.get(f"{side}_wrist", -1)
        if wrist >= 0 and word_of(clip.names[wrist]).stem == "wrist":
            hands = [i for i in np.flatnonzero(clip.parents == wrist) if word_of(clip.names[i]).stem == "hand"]
            out[f"{side}_wrist"] = int(hands[0]) if hands else wrist
    return out


def _leg(points: F64, index: Mapping[str, int]) -> float:
    """Return ``leg_length`` of a rig that may lack its ankles."""
    total = 0.0
    for side in _SIDES:
        hip, knee = points[index[f"{side}_hip"]], points[index[f"{side}_knee"]]
        ankle = points[index[f"{side}_ankle"]] if f"{side}_ankle" in index else 2 * knee - hip
        total += float(np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)) / 2
    return total


def _facing(root: F64) -> F64:
    """Return the rotation [3, 3] about y that makes a root rotation face +z."""
    ahead = root[:, 2]
    return rotation_matrices([0, -np.arctan2(ahead[0], ahead[2]), 0])
