"""Rotations in float64: quaternions to matrices and back, modified Rodrigues parameters, what is rigid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["is_rigid", "quaternion_matrices", "quaternion_of", "rodrigues_parameters"]

F64 = NDArray[np.float64]


def quaternion_matrices(quats: NDArray[np.floating]) -> F64:
    """[..., 4] unit wxyz to [..., 3, 3] (covariance.glsl)."""
    w, x, y, z = np.moveaxis(np.asarray(quats, np.float64), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternion_of(rotation: F64) -> F64:
    """[4] wxyz, w >= 0, of a rotation matrix [3, 3]: the top eigenvector of Davenport's matrix, no bad case."""
    m = rotation
    xx, yy, zz = m[0, 0], m[1, 1], m[2, 2]
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    matrix = np.array(
        [
            [xx + yy + zz, wx, wy, wz],
            [wx, xx - yy - zz, xy, xz],
            [wy, xy, yy - xx - zz, yz],
            [wz, xz, yz, zz - xx - yy],
        ]
    )
    quat: F64 = np.linalg.eigh(matrix)[1][:, -1]
    return -quat if quat[0] < 0 else quat


def rodrigues_parameters(rotation: F64) -> F64:
    """[3] modified Rodrigues parameters tan(angle / 4) axis of a rotation matrix [3, 3], at most 1 long."""
    quat = quaternion_of(rotation)
    return quat[1:] / (1 + quat[0])


def is_rigid(bones: F64) -> bool:
    """Whether every bone's 3x3 of [J, 3, 4] is a rotation within 1e-4."""
    gram = np.einsum("jki,jkl->jil", bones[:, :, :3], bones[:, :, :3])
    return bool(np.abs(gram - np.eye(3)).max() < 1e-4 and (np.linalg.det(bones[:, :, :3]) > 0).all())
