"""The 55 joints of SMPL-X for another rig: their positions in the T-pose, and their frames when it was bound.

The zero pose of SMPL-X is a T-pose; a rig rests in any pose (arms down, fingers bent). Each limb of the rig is turned
until its bones point where those of the reference body do; trunk and head stay as they are, feet stay on their soles.
Joints that a rig lacks are placed as on the reference body, in the rig's proportions, and move the joints below them.
So poses, motions and tracking have the same effect on every rig.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.rigs.match import RigMap, match_rig
from glsplat.rotations import nearest_rotations, rotation_between, rotation_matrices, unit_vectors
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
_SIDES = ("left", "right")
# limbs from the trunk outwards: each bone points from a joint to the next
_CHAINS = [
    [f"{side}_{part}" for part in parts]
    for side in _SIDES
    for parts in (
        ("hip", "knee", "ankle"),
        ("shoulder", "elbow", "wrist"),
        *((f"{finger}1", f"{finger}2", f"{finger}3") for finger in ("thumb", "index", "middle", "ring", "pinky")),
    )
]
_PALM = ("index1", "middle1", "ring1", "pinky1")
_STANDING = 0.5  # cosine between trunk and legs; four-legged animals have less
_ASTRIDE = 0.25  # least distance from the middle of the hips to that of the knees, in thighs
_ASKEW = 0.924  # cosine of 22.5 degrees
_AWAY = 0.5  # of the way from hips to shoulders: a pelvis farther than that from the hips is ignored
_FEW = 3  # fewest knuckles that give a hand's rotation


def upright(rig: RigMap, positions: ArrayLike) -> F64:
    """Return the rotation [3, 3] that makes y up, x the person's left and z their front, by right angles.

    A person whose up is more than 22.5 degrees from an axis of the file is turned by the exact angle.
    Raises PoseError for a rig whose trunk is not above its legs: an animal on four legs.
    """
    points = np.asarray(positions, np.float64)
    at = {name: points[index] for name, index in rig.joints.items()}
    hips, shoulders, knees = ((at[f"left_{part}"] + at[f"right_{part}"]) / 2 for part in ("hip", "shoulder", "knee"))
    trunk, legs = shoulders - hips, hips - knees
    size = float(np.linalg.norm(trunk) * np.linalg.norm(legs))
    if size < 1e-12:
        raise PoseError("the rig has no size: hips, knees and shoulders coincide")
    thighs = [float(np.linalg.norm(at[f"{side}_hip"] - at[f"{side}_knee"])) for side in _SIDES]
    if float(np.linalg.norm(legs)) < _ASTRIDE * np.mean(thighs):  # Bandai-Namco's: cosines would be of rounding errors
        raise PoseError("the legs point apart: this is not a standing person")
    if float(trunk @ legs) / size < _STANDING:
        raise PoseError("the trunk is not above the legs: this is not a standing person")
    up = trunk / np.linalg.norm(trunk) + legs / np.linalg.norm(legs)
    y = _axis(up)
    across = at["left_hip"] - at["right_hip"] + at["left_shoulder"] - at["right_shoulder"]
    if float(up @ y) < _ASKEW * float(np.linalg.norm(up)):
        y = trunk / np.linalg.norm(trunk)  # not the legs: these may be bent
        x = across - y * (across @ y)
        x = x / max(float(np.linalg.norm(x)), 1e-12)
    else:
        x = _axis(across - y * (across @ y))
    if abs(float(x @ y)) > 1e-6:
        raise PoseError("left and right hip are above each other: this is not a standing person")
    return np.stack([x, y, np.cross(x, y)])


@lru_cache(maxsize=1)
def reference_joints() -> F64:
    """Return the joints [55, 3] of the embedded open body in its zero pose and shape, metres, read-only."""
    with resources.as_file(resources.files("glsplat") / "data" / "open_body.npz") as path, np.load(path) as data:
        joints = data["joints"].astype(np.float64)
    joints.flags.writeable = False
    return joints


def _pelvis(rest: Mapping[str, F64], body: F64) -> F64:
    """Return the pelvis [3]: the rig's own joint, or a point between the hips if that is far from them.

    Some rigs have it on the floor. Pelvis and hips are rigid, so any point of them will do.
    """
    hips, shoulders = ((rest[f"left_{part}"] + rest[f"right_{part}"]) / 2 for part in ("hip", "shoulder"))
    at = rest.get("pelvis", hips)
    if np.linalg.norm(at - hips) <= _AWAY * np.linalg.norm(shoulders - hips):
        return np.asarray(at)
    size = _leg(rest) / _leg({name: body[_AT[name]] for name in JOINT_NAMES})
    ours = body[0] - (body[_AT["left_hip"]] + body[_AT["right_hip"]]) / 2
    return np.asarray(hips + size * ours)


def seated(
    rig: RigMap,
    parents: ArrayLike,  # [J]
    bound: F64,  # [J, 4, 4] frames in which the skin was bound
    shown: F64,  # [J, 4, 4] the same frames as a viewer shows them, which have the size
    reference: ArrayLike,  # [55, 3]
    scale: float = 1.0,
) -> tuple[F64, Skeleton, NDArray[np.intp]]:
    """Return upright metres from ``bound``'s space [4, 4], the rig's skeleton with SMPL-X's joints, and [J] which of
    the 55 moves each joint.

    The rest pose is the T-pose, parallel to the world; the inverse bind matrices have the frames of the rig's own rest
    pose. Raises PoseError if a joint of ``match.NEEDED`` is missing.
    """
    if rig.missing:
        raise PoseError(f"a rig cannot be driven without {', '.join(rig.missing)}; name them in a rig map")
    nodes = list(rig.joints.values())
    sizes = [np.cbrt(np.abs(np.linalg.det(frames[nodes, :3, :3]))) for frames in (shown, bound)]
    turn = np.eye(4)
    turn[:3, :3] = scale * float(np.median(sizes[0] / sizes[1])) * upright(rig, bound[:, :3, 3])
    points, body = bound[:, :3, 3] @ turn[:3, :3].T, np.asarray(reference, np.float64)
    at = {name: points[index] for name, index in rig.joints.items()}
    at["pelvis"] = _pelvis(at, body)
    turns = t_pose_turns(at, body)
    rest, frames = np.tile(np.eye(4), (2, len(JOINT_NAMES), 1, 1))
    rest[:, :3, 3] = joints = _t_pose(at, turns, body)
    for index, name in enumerate(JOINT_NAMES):
        frames[index, :3, :3] = turns[name].T
        parent = int(PARENTS[index])
        if name in at:
            frames[index, :3, 3] = at[name]
        else:  # as in the T-pose, under its parent
            bent = frames[parent, :3, :3] @ (joints[index] - joints[parent])
            frames[index, :3, 3] = frames[parent, :3, 3] + bent
    of = _moved_by(rig, np.asarray(parents, np.intp), points)
    return turn, Skeleton(JOINT_NAMES, PARENTS, rest, np.linalg.inv(frames)), of


def t_pose_turns(
    rest: Mapping[str, F64],  # SMPL-X joint -> [3] the rig's position at rest, upright
    reference: F64,  # [55, 3] joints of a body in the T-pose, any unit
) -> dict[str, F64]:
    """Return 55 joints -> world rotation [3, 3] of the bone from the rest pose to the T-pose."""
    body = {name: reference[index] for name, index in _AT.items()}
    across = rest["left_hip"] - rest["right_hip"]
    whole = rotation_between(across * (1, 0, 1), np.array([1.0, 0.0, 0.0]))
    turns = {name: whole for name in JOINT_NAMES}
    for chain in _CHAINS:
        side = chain[0].split("_")[0]
        if chain[0].endswith("1"):  # a finger starts with its hand's rotation
            for name in chain:
                turns[name] = turns[f"{side}_wrist"]
        for name, toward in pairwise(chain):
            if name not in rest or toward not in rest:
                break
            bone = turns[name] @ (rest[toward] - rest[name])
            turns[name] = rotation_between(bone, body[toward] - body[name]) @ turns[name]
            for further in chain[chain.index(name) + 1 :]:
                turns[further] = turns[name]
        if chain[0].endswith("_hip"):
            turns[chain[-1]] = turns[f"{side}_foot"] = _on_its_sole(rest, body, side, whole)
        if chain[0].endswith("_shoulder"):
            _turn_hand(turns, rest, body, side)
    return turns


def _on_its_sole(rest: Mapping[str, F64], body: Mapping[str, F64], side: str, whole: F64) -> F64:
    """Return a foot's rotation [3, 3]: it points where the body's foot does and stays as level as it was."""
    ankle, toe = f"{side}_ankle", f"{side}_foot"
    if ankle not in rest or toe not in rest:
        return whole
    level = np.array([1.0, 0.0, 1.0])
    return rotation_between(whole @ (rest[toe] - rest[ankle]) * level, (body[toe] - body[ankle]) * level) @ whole


def _turn_hand(turns: dict[str, F64], rest: Mapping[str, F64], body: Mapping[str, F64], side: str) -> None:
    """Turn the palm as the body's; the forearm takes half of the twist about its axis."""
    wrist, elbow = f"{side}_wrist", f"{side}_elbow"
    knuckles = [f"{side}_{name}" for name in _PALM if f"{side}_{name}" in rest]
    if wrist not in rest or len(knuckles) < _FEW:
        return
    ours = np.array([body[name] - body[wrist] for name in knuckles])
    theirs = np.array([rest[name] - rest[wrist] for name in knuckles]) @ turns[elbow].T
    ours, theirs = unit_vectors(ours), unit_vectors(theirs)
    # knuckles lie in a plane: its normal is a fourth direction, without which the nearest rotation may mirror
    ours, theirs = (np.vstack([rows, _normal(rows)]) for rows in (ours, theirs))
    turn = nearest_rotations((ours.T @ theirs)[None])[0]
    turns[wrist] = turn @ turns[elbow]
    along = body[wrist] - body[elbow]
    turns[elbow] = _half_twist(turn, along / np.linalg.norm(along)) @ turns[elbow]


def _t_pose(rest: Mapping[str, F64], turns: Mapping[str, F64], body: F64) -> F64:
    """Return positions [55, 3] in the T-pose."""
    joints = np.zeros((len(JOINT_NAMES), 3))
    joints[0] = rest["pelvis"]
    size = _leg(rest) / _leg({name: body[_AT[name]] for name in JOINT_NAMES})
    last = {"pelvis": "pelvis"}  # joint -> the rig's nearest joint at or above it
    for index, name in enumerate(JOINT_NAMES[1:], 1):
        above = last[JOINT_NAMES[int(PARENTS[index])]]
        if name in rest:
            joints[index] = joints[_AT[above]] + turns[above] @ (rest[name] - rest[above])
            last[name] = name
            continue
        last[name] = above
        below = _below(name, rest)
        offset = body[index] - body[_AT[above]]
        if below is None:
            joints[index] = joints[_AT[above]] + size * offset
        else:  # between two of the rig's joints, as far along as on the body
            ours = body[_AT[below]] - body[_AT[above]]
            theirs = turns[above] @ (rest[below] - rest[above])
            share = float(offset @ ours) / max(float(ours @ ours), 1e-12)
            joints[index] = joints[_AT[above]] + share * theirs
    return joints


def _below(name: str, rest: Mapping[str, F64]) -> str | None:
    """Return the rig's first joint below a joint of the spine or a collar; None if there is none."""
    chains = (
        ("spine1", "spine2", "spine3", "neck", "head"),
        *((f"{side}_collar", f"{side}_shoulder", f"{side}_elbow") for side in _SIDES),
    )
    for chain in chains:
        if name in chain:
            return next((further for further in chain[chain.index(name) + 1 :] if further in rest), None)
    return None


def _moved_by(rig: RigMap, parents: NDArray[np.intp], points: F64) -> NDArray[np.intp]:
    """Return [J] which of the 55 moves each joint: itself, an ancestor, a descendant, or the nearest."""
    mine = {index: _AT[name] for name, index in rig.joints.items()}
    below: dict[int, int] = {}
    for index in mine:
        at = int(parents[index])
        while at >= 0 and at not in mine and at not in below:
            below[at] = mine[index]
            at = int(parents[at])
    known = np.array(list(mine))
    out = np.empty(len(parents), np.intp)
    for joint in range(len(parents)):
        at, steps = joint, 0
        while at >= 0 and at not in mine and steps <= len(parents):
            at, steps = int(parents[at]), steps + 1
        if at in mine:
            out[joint] = mine[at]
        elif joint in below:
            out[joint] = below[joint]
        else:
            out[joint] = mine[int(known[np.linalg.norm(points[known] - points[joint], axis=1).argmin()])]
    return out


def _leg(points: Mapping[str, F64]) -> float:
    return sum(float(np.linalg.norm(points[f"{side}_knee"] - points[f"{side}_hip"])) for side in _SIDES) / 2


def _axis(direction: F64) -> F64:
    out = np.zeros(3)
    largest = int(np.abs(direction).argmax())
    out[largest] = np.sign(direction[largest])
    return out


def _normal(rows: F64) -> F64:
    across = np.cross(rows[0], rows[-1])
    return np.asarray(across / max(float(np.linalg.norm(across)), 1e-12))


def _half_twist(turn: F64, along: F64) -> F64:
    """Return half of the twist of ``turn`` about ``along`` as a rotation [3, 3]."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = np.arctan2(float(axis @ along), 1.0 + float(np.trace(turn)))  # of the quaternion's twist, half the angle
    return rotation_matrices(along * angle)


def why_undriven(skeleton: Skeleton) -> str:
    """Return the reason in one line, with the joints that are missing, for a rig that is not SMPL-X's."""
    names = skeleton.names
    try:
        with np.errstate(all="ignore"):  # joints of 1e300 m
            found = match_rig(names, skeleton.parents, skeleton.joints)
            if found.missing:
                some = ", ".join(map(_plain, names[:4])) + (", ..." if len(names) > 4 else "")
                return f"no joint for {', '.join(found.missing)} among its {len(names)} ({some})"
            upright(found, skeleton.joints)
    except PoseError as error:
        return str(error)
    other = next(f"{name} is {_plain(names[index])}" for name, index in found.joints.items() if names[index] != name)
    return f"its joints are another rig's ({other}, ...); glsplat avatar import puts it on the 55 of SMPL-X"


def _plain(name: str) -> str:
    """Return the start of a name, without characters that break the line or control the terminal."""
    return "".join(c if c.isprintable() else "?" for c in name[:24])
