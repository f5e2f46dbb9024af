"""The poses in which avatars are scored: named, fixed, and outside the fit's random poses.

Axis-angle in radians on the SMPL-X joints; left joints are mirrored to the right unless a pose has the right one.
"""

from __future__ import annotations

import numpy as np

from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton

Rotations = dict[str, tuple[float, float, float]]
"""Axis-angle by joint, radians."""

_FINGERS = ("index", "middle", "ring", "pinky")


def fist(side: str, amount: float) -> Rotations:
    """Return the rotations of fingers bent by ``amount`` radians per joint."""
    sign = 1.0 if side == "left" else -1.0
    curl = {f"{side}_{finger}{i}": (0.0, 0.0, -sign * amount) for finger in _FINGERS for i in (1, 2, 3)}
    return {
        **curl,
        f"{side}_thumb2": (0.0, -sign * 0.4 * amount, 0.0),
        f"{side}_thumb3": (0.0, -sign * 0.4 * amount, 0.0),
    }


SCORE_POSES: dict[str, Rotations] = {
    "T-pose": {},
    "arms overhead": {
        "left_collar": (0, 0, 0.25),
        "left_shoulder": (0, 0, 1.1),
        "left_elbow": (0, -0.3, 0),
        "left_hip": (0, 0, 0.25),
        "spine2": (-0.15, 0, 0),
    },
    "hands on hips": {
        "left_shoulder": (0, 0.55, -0.85),
        "left_elbow": (0, -1.9, 0),
        "left_wrist": (0, 0, -0.5),
        "left_hip": (0, 0, 0.15),
    },
    "seated": {
        "left_hip": (-1.5, 0, 0.12),
        "left_knee": (1.5, 0, 0),
        "left_shoulder": (0, -0.5, -1.0),
        "left_elbow": (0, -0.8, 0),
        "neck": (0.2, 0, 0),
    },
    "stride": {
        "left_hip": (-0.9, 0, 0),
        "left_knee": (0.5, 0, 0),
        "right_hip": (0.55, 0, 0),
        "right_knee": (0.9, 0, 0),
        "left_shoulder": (0, 0.7, -1.15),
        "right_shoulder": (0, 0.9, 1.15),
        "left_elbow": (0, -1.5, 0),
        "right_elbow": (0, 1.5, 0),
        "spine1": (0.1, 0.15, 0),
    },
    "reaching out": {
        "left_shoulder": (0, -1.45, 0.1),
        "right_shoulder": (0, 0.5, 0.9),
        "left_elbow": (0, -0.1, 0),
        "right_elbow": (0, 0.2, 0),
        "left_index1": (0, 0.12, 0.1),
        "left_pinky1": (0, -0.2, 0.1),
        "left_hip": (-0.3, 0, 0.1),
        "left_knee": (0.5, 0, 0),
        "right_hip": (0.2, 0, -0.1),
        "head": (0, 0.4, 0),
        "jaw": (0.25, 0, 0),
    },
    "twist with fists": {
        "pelvis": (0, 0.3, 0),
        "spine1": (0, 0.25, 0),
        "spine2": (0, 0.25, 0),
        "spine3": (0, 0.2, 0),
        "head": (0, 0.6, 0),
        "left_shoulder": (0, -0.9, -0.6),
        "left_elbow": (0, -1.8, 0),
        "left_hip": (0, 0, 0.3),
        **fist("left", 1.3),
        **fist("right", 1.3),
    },
    "squat": {
        "left_hip": (-1.9, 0, 0.35),
        "left_knee": (2.1, 0, 0),
        "left_ankle": (-0.3, 0, 0),
        "spine1": (0.3, 0, 0),
        "spine2": (0.2, 0, 0),
        "left_shoulder": (0, -1.3, -0.2),
        "left_elbow": (0, -0.5, 0),
        "left_eye_smplhf": (0, 0.3, 0),
    },
}
"""Joint rotations by pose; a left joint without its right twin stands for both."""


def score_pose(name: str, skeleton: Skeleton) -> Pose:
    """Return a pose of SCORE_POSES on any rig, without the joints that the rig lacks."""
    return pose_of(SCORE_POSES[name], skeleton)


def pose_of(given: Rotations, skeleton: Skeleton) -> Pose:
    """Return named rotations as a pose of any rig; a left joint without its right twin stands for both."""
    rotations = np.zeros((len(skeleton), 3))
    index = {joint: i for i, joint in enumerate(skeleton.names)}
    for joint, (x, y, z) in given.items():
        twin = joint.replace("left", "right", 1)
        if joint in index:
            rotations[index[joint]] = x, y, z
        if twin not in given and twin in index:
            rotations[index[twin]] = np.array([x, -y, -z])  # reflected in the plane x = 0
    return Pose(rotations)
