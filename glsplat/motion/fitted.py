"""Adapt motions: to another body, to a rotated world, and to the floor."""

from __future__ import annotations

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.rotations import quaternion_of, quaternion_product, quaternion_vectors, vector_quaternions
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS

_AT = {name: index for index, name in enumerate(JOINT_NAMES)}
_SIDES = ("left", "right")
_FOOT_NAMES = [f"{side}_{part}" for side in _SIDES for part in ("ankle", "foot")]
_FEET = [_AT[name] for name in _FOOT_NAMES]
_FLOOR_PERCENTILE = 20  # of the lower foot's heights
_SAME_BODY_M = 2e-4  # largest distance of joints of equal bodies; the numbers in motion files are rounded


def body_of(joints: object) -> Skeleton:
    """Return the skeleton of "joints" [55, 3] in a motion file: rest positions, metres, in SMPL-X's order."""
    try:
        points = np.asarray(joints, np.float64)
    except (TypeError, ValueError, OverflowError):
        points = np.zeros(0)
    if points.shape != (len(JOINT_NAMES), 3):
        raise PoseError(f'"joints" of a motion are {len(JOINT_NAMES)} rest positions x y z, found {points.shape}')
    return Skeleton.from_joints(JOINT_NAMES, PARENTS, points)


def leg_length(joints: F64) -> float:
    """Return the length in metres from hip over knee to ankle, mean of both legs; ``joints`` [55, 3] at rest."""
    chains = [[joints[_AT[f"{side}_{part}"]] for part in ("hip", "knee", "ankle")] for side in _SIDES]
    return float(np.mean([np.linalg.norm(np.diff(chain, axis=0), axis=1).sum() for chain in chains]))


def fitted(rotations: F64, trans: F64, made_for: Skeleton, skeleton: Skeleton) -> F64:
    """Return translations [T, 3] for ``skeleton`` of a motion [T, 55, 3], [T, 3] made for another body.

    Translations are scaled by leg length. The lowest foot joint of each frame then keeps its height above its rest
    position, in leg lengths, so that standing feet stand and jumps stay jumps.
    """
    if np.abs(made_for.joints - skeleton.joints).max() < _SAME_BODY_M:
        return trans
    scale = leg_length(skeleton.joints) / max(leg_length(made_for.joints), 1e-9)
    out = trans * scale
    for frame, turns in enumerate(rotations):
        wanted = _clearance(made_for, turns) + trans[frame, 1]
        out[frame, 1] = scale * wanted - _clearance(skeleton, turns)
    return out


def _clearance(skeleton: Skeleton, rotations: F64) -> float:
    """Return the height in metres of the lowest foot joint above its rest position, without a translation."""
    return float((skeleton.forward(rotations)[_FEET, 1, 3] - skeleton.joints[_FEET, 1]).min())


def turned(rotations: F64, trans: F64, turn: F64, skeleton: Skeleton) -> tuple[F64, F64]:
    """Return a motion in a rotated world: x' = Q x for x = R (v - J0) + J0 + t."""
    root = skeleton.joints[0]
    out = np.array(rotations)
    out[:, 0] = quaternion_vectors(quaternion_product(quaternion_of(turn), vector_quaternions(rotations[:, 0])))
    return out, (trans + root) @ turn.T - root


def grounded(rotations: F64, trans: F64, skeleton: Skeleton) -> F64:
    """Return ``trans`` [T, 3] shifted so that a standing foot is at its height in the zero pose.

    Uses a low percentile of the lower foot's height: with the minimum, a single bent toe would lift all frames.
    """
    feet = [i for i, name in enumerate(skeleton.names) if name in _FOOT_NAMES]
    if not feet:
        return trans
    step = max(1, len(trans) // 300)
    rest = skeleton.joints[feet, 1]
    lowest = [
        float((skeleton.forward(turn, shift)[feet, 1, 3] - rest).min())
        for turn, shift in zip(rotations[::step], trans[::step], strict=True)
    ]
    return trans - np.array([0, np.percentile(lowest, _FLOOR_PERCENTILE), 0])
