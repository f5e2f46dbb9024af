"""Clips of the CMU pack, by the pack's own converter: an implementation that is not the project's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from glsplat.motion.motion import Motion
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS

__all__ = ["captured"]


def captured(folder: Path, name: str, skeleton: Skeleton) -> Motion:
    """One clip of the pack in ``folder``. Its modules run in scopes of their own."""
    scope: dict[str, object] = {"__name__": "to_motion"}
    scope |= {"load": _load(folder)}
    text = (folder / "to_motion.py").read_text().replace("from load import load", "")
    exec(compile(text, "to_motion.py", "exec"), scope)
    data = scope["motion"](folder / name, skeleton.joints[0])  # type: ignore[operator]
    rotations = np.zeros((len(data["frames"]), len(JOINT_NAMES), 3))
    for key in ("root_pose", "body_pose"):
        values = np.array([frame[key] for frame in data["frames"]])
        rotations[:, POSE_KEYS[key]] = values.reshape(len(values), -1, 3)
    return Motion(data["fps"], rotations, np.array([frame["trans"] for frame in data["frames"]]))


def _load(folder: Path) -> object:
    scope: dict[str, object] = {"__name__": "load"}
    exec(compile((folder / "load.py").read_text(), "load.py", "exec"), scope)
    return scope["load"]
