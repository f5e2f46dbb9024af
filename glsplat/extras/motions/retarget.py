"""Retarget a clip of any skeleton to the 55 joints of SMPL-X.

First find a standing rest pose and the up axis of the clip, which many files lack or have wrong.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.motions.clip import Clip
from glsplat.extras.rigs.humanoid import t_pose_turns, upright
from glsplat.extras.rigs.match import RigMap, match_rig, other_side
from glsplat.extras.rigs.words import word_of
from glsplat.motion.fitted import leg_length
from glsplat.rotations import (
    matrix_quaternions,
    nearest_rotations,
    quaternion_vectors,
    rotation_between,
    rotation_matrices,
    unit_vectors,
)
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_SIDES = ("left", "right")
_LOOKED_AT = 256  # most frames among which a standing one is sought
_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head", "left_collar", "right_collar")
_ACROSS, _ALONG = 0.3, 0.8  # cosines of the moving body's axis with up at rest (most) and with another axis (least)
# of a leg: most height of soles, least height of hips, most speed of a standing foot in a second
_LOW, _HIGH, _STILL = 0.25, 0.6, 0.3
_NEAR = 0.1  # of a leg: height above a foot's lowest place
_LEAST, _FRAMES = 0.05, 3  # least seconds and frames of a standing foot
_ALIKE, _TILTED = 0.9, 0.75  # least cosines: of a foot's soles with each other, and of their tilt

_RIGID = 0.1  # of a bone: change of length that skins and capture systems cause


@dataclass(frozen=True, eq=False)
class Standing:
    """A clip whose rest pose stands."""

    clip: Clip
    map: RigMap
    rest: F64  # [3, 3] rotates the rest pose upright: y up, x the person's left
    world: F64  # [3, 3] the same for the world in which they move


def standing(clip: Clip, *, swapped: bool = False) -> Standing:
    """Return the clip, with another rest pose if its own does not stand.

    ``swapped``: its left is right. Raises PoseError if no frame stands, or needed joints are missing.
    """
    if swapped:
        found = _matched(clip)
        other = {name: found.joints.get(other_side(name)) for name in JOINT_NAMES}
        clip = replace(clip, given=other)
    found = _matched(clip)
    try:
        turn = upright(found, clip.rest)
    except PoseError as error:
        clip, found, turn = _by_a_frame(clip, found, error)
        return Standing(clip, found, turn, turn)
    moves = np.eye(3) if clip.y_up else _up_as_it_moves(clip, found, turn[1], turn[0])
    return Standing(clip, found, turn, turn @ moves)


def _matched(clip: Clip) -> RigMap:
    found = match_rig(clip.names, clip.parents, clip.rest, clip.given)
    missing = [name for name in found.missing if name != "head"]  # a head without a joint stays as it is
    if missing:
        names = ", ".join(name[:24] for name in clip.names[:8])
        raise PoseError(f"no joint for {', '.join(missing[:4])} among {names}, ...")
    return found


def _by_a_frame(clip: Clip, found: RigMap, error: PoseError) -> tuple[Clip, RigMap, F64]:
    """Make the straightest frame the rest pose, for files whose bones at rest are all parallel (LaFAN's, Rokoko's).

    Trunk and head rest in their mean rotations, as in one frame they may look aside.
    """
    best, straightest = -1, 0.0
    for frame in range(0, len(clip), -(-len(clip) // _LOOKED_AT)):
        straight = _straight(clip.places[frame], found)
        if straight > straightest:
            best, straightest = frame, straight
    if best < 0:
        raise error
    clip = replace(clip, rest=clip.places[best])
    found = _matched(clip)
    base = clip.turns[best].copy()
    at = found.joints
    for name in _TRUNK[1:]:
        if name in at:
            above = int(clip.parents[at[name]])
            if above >= 0:
                usual = np.einsum("tji,tjk->ik", clip.turns[:, above], clip.turns[:, at[name]])
                base[at[name]] = base[above] @ nearest_rotations(usual[None])[0]
    return replace(clip, turns=clip.turns @ base.swapaxes(-1, -2)), found, upright(found, clip.rest)


def _straight(points: F64, found: RigMap) -> float:
    """Return how straight trunk, legs and arms and how upright trunk and legs are; 0 if the person does not stand."""
    try:
        y = upright(found, points)[1]
    except PoseError:
        return 0.0
    if np.abs(y).max() < 1 - 1e-6:  # not along an axis
        return 0.0
    at = {name: points[index] for name, index in found.joints.items()}
    marks = []
    for side in _SIDES:
        hip, knee, shoulder, elbow = (at[f"{side}_{part}"] for part in ("hip", "knee", "shoulder", "elbow"))
        bones = [hip - knee, shoulder - hip] + ([knee - at[f"{side}_ankle"]] if f"{side}_ankle" in at else [])
        marks += [unit_vectors(bone) @ y for bone in bones]
        if f"{side}_wrist" in at:
            marks.append(unit_vectors(elbow - shoulder) @ unit_vectors(at[f"{side}_wrist"] - elbow))
    return float(np.mean(np.maximum(marks, 0)))


def _up_as_it_moves(clip: Clip, found: RigMap, up: F64, left: F64) -> F64:
    """Return the rotation [3, 3] from up while moving to up at rest: some files rest with y up and move with z up.

    The floor distinguishes a person who lies down: along the other axis, the soles would not be at 0.
    """
    places = {name: clip.places[:, found.joints[name]] for name in found.joints}
    hips, knees, shoulders = ((places[f"left_{p}"] + places[f"right_{p}"]) / 2 for p in ("hip", "knee", "shoulder"))
    body = np.mean(unit_vectors(shoulders - hips) + unit_vectors(hips - knees), axis=0) / 2
    other = np.zeros(3)
    other[np.abs(body).argmax()] = np.sign(body[np.abs(body).argmax()])
    if body @ up > _ACROSS or body @ other < _ALONG:
        return np.eye(3)
    leg = 2 * float(np.linalg.norm(clip.rest[found.joints["left_hip"]] - clip.rest[found.joints["left_knee"]]))
    feet = [
        places[f"{side}_{part}"] @ other for side in _SIDES for part in ("ankle", "foot") if f"{side}_{part}" in places
    ]
    above = not feet or abs(float(np.min(feet))) > _LOW * leg or float(np.median(hips @ other)) < _HIGH * leg
    if above and abs(float(np.median(hips @ up))) < _HIGH * leg:  # a person cannot lie in the air
        return np.eye(3)
    turn = rotation_between(other, up)
    across = turn @ (places["left_hip"][0] - places["right_hip"][0])
    about = 2 * np.outer(up, up) - np.eye(3)  # half a turn, so that they start facing ahead as in most files
    return turn if across @ left > 0 else about @ turn


def flat_soles(
    stood: Standing,
    turned: F64,  # [T, 3, 3] of an ankle, upright
    side: str,
) -> F64:
    """Return the local rotation [3, 3] of an ankle that makes its sole flat while it stands; the identity if unknown.

    Joints do not give the sole's tilt at rest: it is level in most files, and tilted with spread legs in others (CMU).
    """
    clip, at = stood.clip, stood.map.joints
    leg = 2 * float(np.linalg.norm(clip.rest[at[f"{side}_hip"]] - clip.rest[at[f"{side}_knee"]]))
    joints = [at[f"{side}_{part}"] for part in ("ankle", "foot") if f"{side}_{part}" in at]
    if len(clip) < 2 or not joints or leg <= 0:
        return np.eye(3)
    speed = np.zeros(len(clip))
    low = np.ones(len(clip), bool)
    for joint in joints:
        steps = np.linalg.norm(np.diff(clip.places[:, joint], axis=0), axis=1) * clip.fps
        speed = np.maximum(speed, np.append(steps, steps[-1]))
        height = clip.places[:, joint] @ stood.world[1]
        low &= height < np.percentile(height, 5) + _NEAR * leg
    stands = low & (speed < _STILL * leg)
    if stands.sum() < max(_LEAST * clip.fps, _FRAMES):
        return np.eye(3)
    up = turned[stands, 1].mean(axis=0)  # the floor's normal as the foot has it
    size = float(np.linalg.norm(up))
    if size < _ALIKE or up[1] < _TILTED * size:
        return np.eye(3)
    return rotation_between([0.0, 1.0, 0.0], up)


_AT = {name: i for i, name in enumerate(JOINT_NAMES)}
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
