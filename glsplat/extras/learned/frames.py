"""The network's inputs and outputs, in the head's yaw frame and in eye heights; training and run time share this code.

No number depends on the position or direction in the room. Lengths are in units of the body's eye height divided by 1.6
(metres of a person whose eyes are at 1.6 m), so that one network serves bodies of every size. Arrays have a leading
axis N: frames of a clip in training, one frame at run time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glsplat.arrays import F32

RATE_HZ = 30.0  # of the network, whatever the samples' rate
TICK_S = 1 / RATE_HZ
MEAN_S = (0.3, 1.0, 3.0)  # time constants of the running means of the head's position
HAND_INPUTS = 13  # tracked, position, two axes, velocity

INPUTS = 1 + 6 + 3 + 1 + 2 * len(MEAN_S) + 2 * HAND_INPUTS
"""Numbers in: eye height, two axes of the head, its velocity, its turning, its recent positions, two hands."""

POINTS = ("pelvis", "left_knee", "right_knee", "left_ankle", "right_ankle", "left_foot", "right_foot")
OUTPUTS = 3 * len(POINTS) + 12 + 12 + 2
"""Numbers out: POINTS, ankles and feet one tick ahead, two axes of pelvis and chest, logits of both feet's contact."""


@dataclass(slots=True)
class TrackedFrames:
    """Head and hands in N frames, in the world, metres; rotations are those of the joints (SMPL-X rest frames)."""

    eye: F32  # [N, 3] between the eyes, the ground at y = 0
    yaw: F32  # [N] heading of the head, radians about y
    head: F32  # [N, 3, 3]
    at: F32  # [N, 2, 3] wrists, left and right; anything where not tracked
    hand: F32  # [N, 2, 3, 3]
    tracked: F32  # [N, 2] 0 or 1


@dataclass(slots=True)
class NetworkOutput:
    """The estimated body in N frames, in the head's yaw frame: origin below the eyes, metres."""

    points: F32  # [N, 7, 3] POINTS
    ahead: F32  # [N, 4, 3] ankles and feet one tick later, in the present yaw frame
    pelvis: F32  # [N, 3, 2] x and z axes of the pelvis, columns; not quite orthonormal
    chest: F32  # [N, 3, 2]
    contact: F32  # [N, 2] logits: above 0 the foot stands

    @classmethod
    def of(cls, numbers: F32, unit: float) -> NetworkOutput:
        """Return the parts of [N, OUTPUTS]."""
        n = len(numbers)
        points = numbers[:, :21].reshape(n, 7, 3) * unit
        ahead = numbers[:, 21:33].reshape(n, 4, 3) * unit
        axes = numbers[:, 33:45].reshape(n, 2, 3, 2)
        return cls(points, ahead, axes[:, 0], axes[:, 1], numbers[:, 45:])


def unit_of(eye_height: float) -> float:
    """Return the network's unit of length in metres."""
    return eye_height / 1.6


def in_yaw_frame(vectors: F32, yaw: F32) -> F32:
    """Transform world vectors [N, ..., 3] to the frames turned by ``yaw`` [N] about y."""
    shape = (-1,) + (1,) * (vectors.ndim - 2)
    c, s = np.cos(yaw).reshape(shape), np.sin(yaw).reshape(shape)
    x, z = vectors[..., 0], vectors[..., 2]
    return np.stack((x * c - z * s, vectors[..., 1], x * s + z * c), -1)


def yaw_of(head: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the headings [N] of rotations [N, 3, 3]: their twist about y; undefined upside down."""
    return np.arctan2(head[..., 0, 2] - head[..., 2, 0], head[..., 0, 0] + head[..., 2, 2])


def updated_means(means: F32, eye: F32) -> F32:
    """Update running means [..., 3, 2] of the head's position over the ground by one tick with ``eye`` [..., 3]."""
    k = np.array([1 - np.exp(-TICK_S / tau) for tau in MEAN_S], np.float32)[:, None]
    return means + (eye[..., None, [0, 2]] - means) * k


def network_inputs(now: TrackedFrames, before: TrackedFrames, means: F32, unit: float) -> F32:
    """Return inputs [N, INPUTS] of these frames, those one tick earlier, and the running means [N, 3, 2]."""
    n, yaw = len(now.yaw), now.yaw
    k = 1 / unit
    turned = (yaw - before.yaw + np.pi) % (2 * np.pi) - np.pi
    velocity = in_yaw_frame(now.eye - before.eye, yaw) * (k * RATE_HZ)
    away = np.zeros((n, len(MEAN_S), 3), np.float32)
    away[..., [0, 2]] = means - now.eye[:, None, [0, 2]]
    axes = in_yaw_frame(now.head[:, :, [1, 2]].transpose(0, 2, 1), yaw)
    mask = now.tracked[..., None]
    place = in_yaw_frame(now.at - now.eye[:, None], yaw) * (k * mask)
    moved = in_yaw_frame(now.at - before.at, yaw) * (k * RATE_HZ * mask * before.tracked[..., None])
    hands = in_yaw_frame(now.hand[..., [1, 2]].transpose(0, 1, 3, 2).reshape(n, 4, 3), yaw).reshape(n, 2, 6) * mask
    return np.concatenate(
        (
            now.eye[:, 1:2] * k,
            axes.reshape(n, 6),
            velocity,
            turned[:, None] * RATE_HZ * 0.2,
            in_yaw_frame(away, yaw)[..., [0, 2]].reshape(n, -1) * k,
            np.concatenate((mask, place, hands, moved * 0.5), -1).reshape(n, -1),
        ),
        -1,
        dtype=np.float32,
    )
