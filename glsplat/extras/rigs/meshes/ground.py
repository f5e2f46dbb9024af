"""Put a person on the floor: the soles of the T-pose on y = 0, and missing foot joints into the shoes."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F64
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import strongest_joint
from glsplat.skinning.smplx import JOINT_NAMES

_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
_SOLE = 0.0165  # of the stature; height of the foot joint (the ball) above the floor, as on the reference body
_ANKLE = 0.045  # of the stature
_BALL = 0.7  # of the way from heel to tip
_CLEARLY = 2.0  # a shoe that reaches this many times as far behind the ankle as before it points backwards


def on_the_floor(
    skeleton: Skeleton,  # the 55 joints of SMPL-X, rest frames parallel to the world
    vertices: F64,  # [V, 3] as bound
    joints: NDArray[np.int64],  # [V, K]
    weights: F64,  # [V, K]
    known: Collection[str],  # joints that the rig has; all others were placed by the reference body
) -> tuple[Skeleton, F64]:
    """Move skeleton and vertices alike, so that the lowest vertex is on y = 0 and the pelvis over the origin.

    Missing ankles and balls of the feet are placed in the shoes, as motions and tracking use them for the sole's
    height. They move no vertex, so the picture does not change.
    """
    bones = skeleton.bone_matrices(np.zeros((len(skeleton), 3)))
    posed = np.zeros_like(vertices)
    for column in range(joints.shape[1]):
        rows = bones[joints[:, column], :3]
        posed += weights[:, column, None] * (np.einsum("vij,vj->vi", rows[:, :, :3], vertices) + rows[:, :, 3])
    shift = np.array([-skeleton.joints[0, 0], -posed[:, 1].min(), -skeleton.joints[0, 2]])
    rest, inverse = skeleton.rest.copy(), skeleton.inverse_bind.copy()
    rest[:, :3, 3] += shift
    inverse[:, :3, 3] -= inverse[:, :3, :3] @ shift
    heaviest = strongest_joint(joints, weights)
    stature = float(np.ptp(posed[:, 1]))
    for side in ("left", "right"):
        ankle, ball = _AT[f"{side}_ankle"], _AT[f"{side}_foot"]
        moved = rest[[ankle, ball], :3, 3]
        if f"{side}_ankle" not in known:
            rest[ankle, 1, 3] = np.clip(rest[ankle, 1, 3], _ANKLE * stature, rest[_AT[f"{side}_knee"], 1, 3])
        if f"{side}_foot" not in known:
            shoe = posed[np.isin(heaviest, (ankle, ball))] + shift
            rest[ball, 1, 3] = min(_SOLE * stature, max(float(rest[ankle, 1, 3]), 0.0) / 2)
            if len(shoe) and np.ptp(shoe[:, 2]) > 0:
                least = (rest[ankle, 2, 3] + rest[ball, 2, 3]) / 2  # a box for a shoe has no front
                rest[ball, 2, 3] = max(float(shoe[:, 2].min() + _BALL * np.ptp(shoe[:, 2])), float(least))
        for joint, before in zip((ankle, ball), moved, strict=True):  # the zero pose moves no vertex
            inverse[joint, :3, 3] += before - rest[joint, :3, 3]
    return Skeleton(skeleton.names, skeleton.parents, rest, inverse), vertices + shift


def faces_back(
    skeleton: Skeleton,
    vertices: F64,  # [V, 3] as bound
    joints: NDArray[np.int64],  # [V, K]
    weights: F64,  # [V, K]
    known: Collection[str],
) -> bool:
    """Return whether both feet point backwards: then the file's left is the right.

    The toes decide where the rig has them, else the shoes as they were bound.
    """
    heaviest = strongest_joint(joints, weights)
    bound = np.linalg.inv(skeleton.inverse_bind)
    votes = []
    for side in ("left", "right"):
        ankle, ball = _AT[f"{side}_ankle"], _AT[f"{side}_foot"]
        if not {f"{side}_ankle", f"{side}_foot"} - set(known):
            votes.append(bound[ball, 2, 3] < bound[ankle, 2, 3])
            continue
        shoe = vertices[np.isin(heaviest, (ankle, ball)), 2] - bound[ankle, 2, 3]
        votes.append(len(shoe) > 0 and -shoe.min() > _CLEARLY * max(float(shoe.max()), 0.0))
    return all(votes)
