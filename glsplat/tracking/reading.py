"""Read poses and positions of devices into the avatar's metres; None for those that cannot be one."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from glsplat.tracking.solve.quat import JointPose, Vec

__all__ = ["invalid", "read_place", "read_pose"]

MAX_DISTANCE_M = 1e4  # a device farther away is not tracked


def read_pose(pose: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> JointPose | None:
    """Return position and rotation of 7 numbers; a pose that is not seven numbers is flagged "invalid"."""
    if pose is None:
        return None
    try:
        x, y, z, qx, qy, qz, qw = pose
        if not within_range(x, y, z):
            return None
        n = qx * qx + qy * qy + qz * qz + qw * qw
        if not 1e-8 < n < 1e8:  # NaN fails this too
            return None
        n = 1 / sqrt(n)
    except (TypeError, ValueError):  # not seven numbers
        invalid(flags)
        return None
    k = 1 / scale
    return (x * k, (y - floor) * k, z * k), (qw * n, qx * n, qy * n, qz * n)


def read_place(joint: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> Vec | None:
    """Return the position in the first three numbers."""
    if joint is None:
        return None
    try:
        x, y, z = joint[:3]
        return (x / scale, (y - floor) / scale, z / scale) if within_range(x, y, z) else None
    except (TypeError, ValueError):
        invalid(flags)
        return None


def within_range(x: float, y: float, z: float) -> bool:
    """Return whether a position is finite and within ``MAX_DISTANCE_M``."""
    far = MAX_DISTANCE_M  # NaN fails every comparison, infinity these
    return -far < x < far and -far < y < far and -far < z < far


def invalid(flags: list[str]) -> None:
    """Flag that the sample holds something of another type than it should."""
    if "invalid" not in flags:
        flags.append("invalid")
