"""The 55 joints of SMPL-X: names, order, parents, and the joints of each pose key."""

from __future__ import annotations

import numpy as np

_FINGERS = ("index", "middle", "pinky", "ring", "thumb")

JOINT_NAMES: tuple[str, ...] = (
    *("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle"),
    *("right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head"),
    *("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist"),
    *("jaw", "left_eye_smplhf", "right_eye_smplhf"),
    *(f"left_{finger}{i}" for finger in _FINGERS for i in (1, 2, 3)),
    *(f"right_{finger}{i}" for finger in _FINGERS for i in (1, 2, 3)),
)
"""Official SMPL-X order."""

_BODY_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15]
_LEFT = [parent for base in range(25, 40, 3) for parent in (20, base, base + 1)]
_RIGHT = [parent for base in range(40, 55, 3) for parent in (21, base, base + 1)]

PARENTS = np.array(_BODY_PARENTS + _LEFT + _RIGHT, np.int32)  # [55]

POSE_KEYS: dict[str, slice] = {
    "root_pose": slice(0, 1),
    "body_pose": slice(1, 22),
    "jaw_pose": slice(22, 23),
    "leye_pose": slice(23, 24),
    "reye_pose": slice(24, 25),
    "lhand_pose": slice(25, 40),
    "rhand_pose": slice(40, 55),
}
"""Joints of each key of a pose object (LHM's layout; hands relative to the flat hand)."""

SMPLX_NAMES: dict[str, str] = {
    "global_orient": "root_pose",
    "transl": "trans",
    "left_hand_pose": "lhand_pose",
    "right_hand_pose": "rhand_pose",
}
"""Keys of a pose object by SMPL-X's own names."""
