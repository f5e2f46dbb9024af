"""What a device says, judged: places and rotations in the avatar's metres, or None for what cannot be one."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from glsplat.tracking.solve.quat import Quat, Vec

__all__ = ["invalid", "read_place", "read_pose"]

FAR = 1e4  # metres; a device farther away is not tracked


def read_pose(pose: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> tuple[Vec, Quat] | None:
    """Place and rotation of 7 numbers; a pose that is not seven numbers is flagged "invalid"."""
    if pose is None:
        return None
    try:
        x, y, z, qx, qy, qz, qw = pose
        # NaN fails every comparison, infinity these
        if not (-FAR < x < FAR and -FAR < y < FAR and -FAR < z < FAR):
            return None
        n = qx * qx + qy * qy + qz * qz + qw * qw
        if not 1e-8 < n < 1e8:
            return None
        n = 1 / sqrt(n)
    except (TypeError, ValueError):  # not seven numbers
        invalid(flags)
        return None
    k = 1 / scale
    return (x * k, (y - floor) * k, z * k), (qw * n, qx * n, qy * n, qz * n)


def read_place(joint: Sequence[float] | None, scale: float, floor: float, flags: list[str]) -> Vec | None:
    """The first three numbers, a place."""
    if joint is None:
        return None
    try:
        x, y, z = joint[:3]
        if not (-FAR < x < FAR and -FAR < y < FAR and -FAR < z < FAR):
            return None
        return (x / scale, (y - floor) / scale, z / scale)
    except (TypeError, ValueError):
        invalid(flags)
        return None


def invalid(flags: list[str]) -> None:
    """Something is not what a sample holds."""
    if "invalid" not in flags:
        flags.append("invalid")
