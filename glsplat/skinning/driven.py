"""Whether a skeleton can be driven: by motions and poses of SMPL-X's joints, and by the tracking of a headset.

All commands, the server and the solver ask here, so that one avatar is judged alike everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from glsplat.errors import PoseError
from glsplat.extras.rigs.humanoid import upright
from glsplat.extras.rigs.match import match_rig
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES

__all__ = ["why_not_driven", "why_not_tracked"]

_PARALLEL = 1e-4  # largest difference of two rest frames' axes
_FEET = [JOINT_NAMES.index(f"{side}_foot") for side in ("left", "right")]
_EYES = [JOINT_NAMES.index(f"{side}_eye_smplhf") for side in ("left", "right")]
_LOWEST = 0.1  # metres from the feet to the eyes


@lru_cache(maxsize=16)  # asked for every pose that is read
def why_not_driven(skeleton: Skeleton | None) -> str:
    """Why no motion of SMPL-X's 55 joints moves it, with the joints that are missing, in one line; "" where they do.

    None is a thing without a skeleton.

    >>> limb = glsplat.Skeleton.from_joints(["hip.L", "knee.L"], [-1, 0], [[0, 1, 0], [0, 0.5, 0]])
    >>> glsplat.skinning.driven.why_not_driven(limb)[:48]
    'no joint for head, right_hip, right_knee, left_s'
    """
    if skeleton is None:
        return "it has no skeleton"
    names = skeleton.names
    if names == JOINT_NAMES:
        axes = skeleton.rest[:, :3, :3]
        return "" if np.abs(axes - axes[0]).max() <= _PARALLEL else "the axes of its joints are not parallel at rest"
    if sorted(names) == sorted(JOINT_NAMES):
        return "its joints are not in SMPL-X's order; glsplat avatar import puts them there"
    try:
        with np.errstate(all="ignore"):  # joints of 1e300 m
            found = match_rig(names, skeleton.parents, skeleton.joints)
            if found.missing:
                return f"no joint for {', '.join(found.missing)} among its {len(names)} ({_some(names)})"
            upright(found, skeleton.joints)
    except PoseError as error:
        return str(error)
    other = next(f"{name} is {_plain(names[index])}" for name, index in found.joints.items() if names[index] != name)
    return f"its joints are another rig's ({other}, ...); glsplat avatar import puts it on the 55 of SMPL-X"


def why_not_tracked(skeleton: Skeleton | None) -> str:
    """Why a headset's tracking is not solved for it, in one line; "" where it is."""
    why = why_not_driven(skeleton)
    if why or skeleton is None:
        return why
    if np.abs(skeleton.rest[:, :3, :3] - np.eye(3)).max() > _PARALLEL:
        return "its rest frames are not parallel to the world, as they are in SMPL-X's zero pose"
    span = float(skeleton.joints[_EYES, 1].mean() - skeleton.joints[_FEET, 1].mean())
    return "" if span > _LOWEST else f"it does not stand at rest: the eyes are {span:.2f} m above the feet"


def _some(names: Sequence[str]) -> str:
    return ", ".join(_plain(name) for name in names[:4]) + (", ..." if len(names) > 4 else "")


def _plain(name: str) -> str:
    """Of a stranger's file: nothing that breaks the line or steers the terminal."""
    return "".join(c if c.isprintable() else "?" for c in name[:24])
