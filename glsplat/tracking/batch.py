"""Whole motions at once: rotation conversions, forward kinematics and resampling for T frames (numpy)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.skinning.skeleton import Skeleton, rotation_matrices

__all__ = ["axis_angles", "forward_all", "quats_from_matrices", "resample"]

Array = NDArray[np.float64]


def quats_from_matrices(matrices: Array) -> Array:
    """[..., 3, 3] to unit quaternions [..., 4] (w, x, y, z), by the largest component (stable at 180 degrees)."""
    m = np.asarray(matrices, np.float64)
    diagonal = m[..., [0, 1, 2], [0, 1, 2]]
    trace = diagonal.sum(-1)
    # 4 w^2, 4 x^2, 4 y^2, 4 z^2
    squares = np.stack([1 + trace, *(1 - trace + 2 * diagonal[..., i] for i in range(3))], -1)
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 0] + m[..., 0, 2], m[..., 2, 1] + m[..., 1, 2]
    rows = np.stack(
        [
            np.stack([squares[..., 0], wx, wy, wz], -1),
            np.stack([wx, squares[..., 1], xy, xz], -1),
            np.stack([wy, xy, squares[..., 2], yz], -1),
            np.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        -2,
    )
    best = squares.argmax(-1)
    quats = np.take_along_axis(rows, best[..., None, None], -2)[..., 0, :]
    return quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def _axis_angle_quats(axis_angle: Array) -> Array:
    angle = np.linalg.norm(axis_angle, axis=-1, keepdims=True)
    return np.concatenate([np.cos(angle / 2), axis_angle * 0.5 * np.sinc(angle / (2 * np.pi))], -1)


def axis_angles(quats: Array) -> Array:
    """Unit quaternions [..., 4] (w, x, y, z) to axis-angle [..., 3], at most pi long."""
    q = np.where(quats[..., :1] < 0, -quats, quats)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(s, q[..., :1])
    return q[..., 1:] * np.where(s > 1e-12, angle / np.maximum(s, 1e-12), 2.0)


def forward_all(skeleton: Skeleton, rotations: Array, trans: Array) -> tuple[Array, Array]:
    """World positions [T, J, 3] and rotations [T, J, 3, 3] of axis-angle [T, J, 3] and trans [T, 3].

    For rigs whose rest frames are parallel to the world (SMPL-X).
    """
    local = rotation_matrices(rotations)
    rest, parents = skeleton.joints, skeleton.parents
    frames, positions = np.empty_like(local), np.empty(rotations.shape)
    for joint in range(len(skeleton)):  # SMPL-X lists parents first
        parent = int(parents[joint])
        if parent < 0:
            frames[:, joint], positions[:, joint] = local[:, joint], trans + rest[joint]
        else:
            frames[:, joint] = frames[:, parent] @ local[:, joint]
            positions[:, joint] = positions[:, parent] + frames[:, parent] @ (rest[joint] - rest[parent])
    return positions, frames


def resample(rotations: Array, trans: Array, fps: float, rate: float) -> tuple[Array, Array]:
    """The motion at another frame rate: cubic Hermite (Catmull-Rom) on trans and on sign-aligned quaternions."""
    frames = len(trans)
    if frames < 2 or abs(rate - fps) < 1e-9:
        return rotations, trans
    quats = _axis_angle_quats(rotations)
    flips = np.where((quats[1:] * quats[:-1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    quats[1:] *= np.cumprod(flips, axis=0)
    when = np.arange(int(np.floor((frames - 1) / fps * rate + 1e-9)) + 1) * (fps / rate)
    out = _hermite(quats.reshape(frames, -1), when).reshape(-1, *quats.shape[1:])
    return axis_angles(out / np.linalg.norm(out, axis=-1, keepdims=True)), _hermite(trans, when)


def _hermite(values: Array, when: NDArray[np.floating]) -> Array:
    k = np.clip(np.floor(when).astype(np.intp), 0, len(values) - 2)
    s = (when - k)[:, None]
    p0, p1 = values[k], values[k + 1]
    tangents = np.gradient(values, axis=0)
    m0, m1 = tangents[k], tangents[k + 1]
    s2, s3 = s * s, s * s * s
    return (2 * s3 - 3 * s2 + 1) * p0 + (s3 - 2 * s2 + s) * m0 + (3 * s2 - 2 * s3) * p1 + (s3 - s2) * m1
