"""Whether motions of SMPL-X's joints, and a headset's tracking, can drive a skeleton: one check for all callers."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from glsplat.optional import plugin
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

_TOLERANCE = 1e-4  # of rest frames
_FEET = [JOINT_NAMES.index(f"{side}_foot") for side in ("left", "right")]
_EYES = [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]
_MIN_EYE_HEIGHT_M = 0.1  # above the feet


@lru_cache(maxsize=16)  # called for every pose that is read
def why_not_driven(skeleton: Skeleton | None) -> str:
    """Return why motions of SMPL-X's 55 joints do not move a skeleton, in one line; "" where they do.

    The line names the missing joints if glsplat.extras.rigs is installed. None: a thing without a skeleton.

    >>> limb = glsplat.Skeleton.from_joints(["hip.L", "knee.L"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    >>> glsplat.skinning.driven.why_not_driven(limb)[:48]
    'no joint for head, right_hip, right_knee, left_s'
    """
    if skeleton is None:
        return "it has no skeleton"
    if skeleton.names == JOINT_NAMES:
        axes = skeleton.rest[:, :3, :3]
        return "" if np.abs(axes - axes[0]).max() <= _TOLERANCE else "the axes of its joints are not parallel at rest"
    if sorted(skeleton.names) == sorted(JOINT_NAMES):
        return "its joints are not in SMPL-X's order; glsplat avatar import puts them there"
    undriven = plugin("rigs.humanoid")
    if undriven is not None:
        return str(undriven.why_undriven(skeleton))
    return f"its {len(skeleton)} joints are not the 55 of SMPL-X; glsplat avatar import puts a person on those"


def why_not_tracked(skeleton: Skeleton | None) -> str:
    """Return why tracking cannot drive a skeleton, in one line; "" where it can."""
    why = why_not_driven(skeleton)
    if why or skeleton is None:
        return why
    if np.abs(skeleton.rest[:, :3, :3] - np.eye(3)).max() > _TOLERANCE:
        return "its rest frames are not parallel to the world, as they are in SMPL-X's zero pose"
    height = float(skeleton.joints[_EYES, 1].mean() - skeleton.joints[_FEET, 1].mean())
    if height <= _MIN_EYE_HEIGHT_M:
        return f"it does not stand at rest: the eyes are {height:.2f} m above the feet"
    return ""
