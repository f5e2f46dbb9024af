"""Motions in another world: turned, and with their feet on its floor."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import quaternion_of, quaternion_product, quaternion_vectors, vector_quaternions
from glsplat.skinning.skeleton import Skeleton

__all__ = ["grounded", "turned"]

F64 = NDArray[np.float64]

_STANDING = 20  # percent of the frames in which the lower foot may be below the floor
_FEET = ("left_ankle", "right_ankle", "left_foot", "right_foot")


def turned(rotations: F64, trans: F64, turn: F64, skeleton: Skeleton) -> tuple[F64, F64]:
    """A motion in a turned world: x' = Q x for x = R (v - J0) + J0 + t."""
    root = skeleton.joints[0]
    out = np.array(rotations)
    out[:, 0] = quaternion_vectors(quaternion_product(quaternion_of(turn), vector_quaternions(rotations[:, 0])))
    return out, (trans + root) @ turn.T - root


def grounded(rotations: F64, trans: F64, skeleton: Skeleton) -> F64:
    """``trans`` shifted so that the lower foot stands as high as in the zero pose most of the time it stands.

    The height is a low percentile over the frames, not the minimum: a toe that bends down would lift the rest.
    """
    feet = [i for i, name in enumerate(skeleton.names) if name in _FEET]
    if not feet:
        return trans
    step = max(1, len(trans) // 300)
    rest = skeleton.joints[feet, 1]
    lowest = [
        float((skeleton.forward(turn, shift)[feet, 1, 3] - rest).min())
        for turn, shift in zip(rotations[::step], trans[::step], strict=True)
    ]
    return trans - np.array([0, np.percentile(lowest, _STANDING), 0])
