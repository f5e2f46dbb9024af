"""Solved or true poses of a recording, read from JSON Lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError, PoseError
from glsplat.skinning.pose import Pose
from glsplat.skinning.smplx import JOINT_NAMES
from glsplat.tracking.recording import json_lines


@dataclass(frozen=True, eq=False)
class PoseTrack:
    """Solved (or true) poses of a recording."""

    times: NDArray[np.float64]  # [T] seconds
    rotations: NDArray[np.float64]  # [T, 55, 3] axis-angle
    trans: NDArray[np.float64]  # [T, 3]
    joints: NDArray[np.float64]  # [T, 55, 3] in the world
    reach_error: NDArray[np.float64]  # [T, 2] metres, left and right
    flags: list[list[str]]

    @property
    def rate(self) -> float:
        """Samples per second (median)."""
        return float(1 / np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def read_poses(path: str | Path) -> PoseTrack:
    """Read poses of ``tracking solve`` or ``from-motion --truth``. Raises FormatError naming file and line."""
    times, rotations, trans, joints, reach, flags = [], [], [], [], [], []
    for number, data in json_lines(path):
        try:
            if not isinstance(data, dict) or "joints" not in data or "t" not in data:
                raise PoseError('a line of poses needs "t", "joints" and the pose keys')
            pose = Pose.from_smplx({key: value for key, value in data.items() if key != "joints"})
            points = np.asarray(data["joints"], np.float64)
            if points.shape != (len(JOINT_NAMES), 3) or not np.isfinite(points).all():
                raise PoseError(f'"joints" needs {len(JOINT_NAMES)} x 3 finite numbers, found shape {points.shape}')
            times.append(float(data["t"]))
            error = data.get("reach_error") or (0.0, 0.0)
            reach.append((float(error[0] or 0.0), float(error[1] or 0.0)))
        except PoseError as error:
            raise FormatError(f"{path}, line {number}: {error}") from None
        except (TypeError, ValueError, IndexError, KeyError) as error:
            raise FormatError(f"{path}, line {number}: not a line of poses ({error})") from None
        rotations.append(pose.rotations)
        trans.append(pose.trans)
        joints.append(points)
        flags.append([str(flag) for flag in data.get("flags", [])])
    if not times:
        raise FormatError(f"{path}: expected poses, one JSON object a line, found none")
    return PoseTrack(np.array(times), np.array(rotations), np.array(trans), np.array(joints), np.array(reach), flags)
