"""Forward kinematics and resampling of T frames at once (numpy)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from glsplat.rotations import quaternion_vectors, rotation_matrices, vector_quaternions
from glsplat.skinning.skeleton import Skeleton

Array = NDArray[np.float64]


def forward_all(skeleton: Skeleton, rotations: Array, trans: Array) -> tuple[Array, Array]:
    """Return world positions [T, J, 3] and rotations [T, J, 3, 3] of axis-angle [T, J, 3] and trans [T, 3].

    The rig's rest frames must be parallel to the world (SMPL-X).
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
    """Resample a motion from ``fps`` to ``rate``: cubic Hermite (Catmull-Rom) on trans and sign-aligned quaternions."""
    frames = len(trans)
    if frames < 2 or abs(rate - fps) < 1e-9:
        return rotations, trans
    quats = vector_quaternions(rotations)
    flips = np.where((quats[1:] * quats[:-1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    quats[1:] *= np.cumprod(flips, axis=0)
    when = np.arange(int(np.floor((frames - 1) / fps * rate + 1e-9)) + 1) * (fps / rate)
    out = _hermite(quats.reshape(frames, -1), when).reshape(-1, *quats.shape[1:])
    return quaternion_vectors(out / np.linalg.norm(out, axis=-1, keepdims=True)), _hermite(trans, when)


def _hermite(values: Array, when: NDArray[np.floating]) -> Array:
    k = np.clip(np.floor(when).astype(np.intp), 0, len(values) - 2)
    s = (when - k)[:, None]
    p0, p1 = values[k], values[k + 1]
    tangents = np.gradient(values, axis=0)
    m0, m1 = tangents[k], tangents[k + 1]
    s2, s3 = s * s, s * s * s
    return (2 * s3 - 3 * s2 + 1) * p0 + (s3 - 2 * s2 + s) * m0 + (3 * s2 - 2 * s3) * p1 + (s3 - s2) * m1
