"""Motions of the AMASS archive: .npz with SMPL-H's ``poses`` or SMPL-X's keys, z up (amass.is.tue.mpg.de)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import BinaryIO

import numpy as np

from glsplat.arrays import F64
from glsplat.errors import PoseError
from glsplat.extras.formats.npz import read_arrays
from glsplat.motion.fitted import grounded, turned
from glsplat.motion.motion import Motion
from glsplat.rotations import rotation_matrices
from glsplat.skinning.driven import why_not_driven
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.smplx import JOINT_NAMES, POSE_KEYS

_AMASS_KEYS = (
    *("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand"),  # SMPL-X
    *("poses", "trans", "mocap_framerate", "mocap_frame_rate"),
)


def read_amass(file: BinaryIO, skeleton: Skeleton, forward: bool) -> Motion:
    """Read an open archive: y up, starting above the origin; ``forward`` turns it to face +z. Raises PoseError."""
    if why := why_not_driven(skeleton):
        raise PoseError(f"AMASS cannot drive this avatar: {why}")
    try:
        found = read_arrays(file, "an AMASS motion", (), optional=_AMASS_KEYS, error=PoseError)
        data = {key: np.asarray(array, np.float64) for key, array in found.items()}
    except (TypeError, ValueError) as error:
        raise PoseError(f"an AMASS motion is an .npz of numbers, but {error}") from None
    if "pose_body" not in data and "poses" not in data:
        raise PoseError("an AMASS motion needs poses, or root_orient and pose_body; found neither")
    frames = len(data.get("pose_body", data.get("poses", ())))
    rotations = np.zeros((frames, len(JOINT_NAMES), 3))
    if "pose_body" in data:
        if "root_orient" not in data:
            raise PoseError("an AMASS motion with pose_body needs root_orient")
        rotations[:, POSE_KEYS["root_pose"]] = _shaped(data, "root_orient", frames, 1)
        rotations[:, POSE_KEYS["body_pose"]] = _shaped(data, "pose_body", frames, 21)
        if "pose_jaw" in data:
            rotations[:, POSE_KEYS["jaw_pose"]] = _shaped(data, "pose_jaw", frames, 1)
        if "pose_eye" in data:
            rotations[:, 23:25] = _shaped(data, "pose_eye", frames, 2)
        if "pose_hand" in data:
            rotations[:, 25:55] = _shaped(data, "pose_hand", frames, 30)
    else:
        width = data["poses"].shape[1] if data["poses"].ndim == 2 else 0
        if width not in (72, 156, 165):
            raise PoseError(f"poses need 156 numbers a frame (SMPL-H; 72 or 165 work too), found {data['poses'].shape}")
        count = width // 3
        poses = _shaped(data, "poses", frames, count)
        if count == 52:  # SMPL-H: body, then both hands
            rotations[:, :22], rotations[:, 25:] = poses[:, :22], poses[:, 22:]
        elif count == 55:
            rotations[:] = poses
        else:  # SMPL: the last two are palms
            rotations[:, :22] = poses[:, :22]
    trans = _shaped(data, "trans", frames, 1)[:, 0] if "trans" in data else np.zeros((frames, 3))
    rates = [data[k] for k in ("mocap_framerate", "mocap_frame_rate") if k in data]
    fps = float(rates[0].reshape(-1)[0]) if rates and rates[0].size else 120.0
    Motion(fps, rotations, trans)  # refuses invalid numbers before they are turned
    z_to_y = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # -90 degrees about x
    rotations, trans = turned(rotations, trans, z_to_y, skeleton)
    if forward:
        ahead = rotation_matrices(rotations[0, 0])[:, 2]
        turn = rotation_matrices([0, -np.arctan2(ahead[0], ahead[2]), 0])
        rotations, trans = turned(rotations, trans, turn, skeleton)
    return Motion(fps, rotations, grounded(rotations, trans - trans[0] * (1, 0, 1), skeleton))


def _shaped(data: Mapping[str, F64], key: str, frames: int, joints: int) -> F64:
    if data[key].size != frames * joints * 3 or len(data[key]) != frames:
        raise PoseError(f"{key} needs {frames} x {joints * 3} numbers, found shape {data[key].shape}")
    return data[key].reshape(frames, joints, 3)
