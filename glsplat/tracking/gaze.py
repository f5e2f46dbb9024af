"""Gaze: how far an eye's joint turns for the direction that a headset says it looks in."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

from glsplat.tracking.solve.quat import Vec, between, rotation_vector

__all__ = ["EYES", "eye_turn"]

EYES = (23, 24)
"""The joints of the left and the right eye; at rest they look along +z of the head's joint."""

FARTHEST = 0.75  # radians, 43 degrees: as far as an eye turns in its socket
_REST: Vec = (0.0, 0.0, 0.0)


def eye_turn(gaze: Sequence[float] | None, flags: list[str]) -> Vec:
    """Axis-angle of an eye that looks along ``gaze`` [3], of any length, in the head's axes (-z ahead).

    By the shortest way, without a roll (Listing's law), at most 43 degrees. What is no direction leaves the eye at
    rest; what is not three numbers is flagged "invalid".
    """
    if gaze is None:
        return _REST
    try:
        x, y, z = gaze
        size = x * x + y * y + z * z
        if not 1e-12 < size < 1e12:  # NaN fails this too
            return _REST
        k = 1 / sqrt(size)
    except (TypeError, ValueError, OverflowError):
        if "invalid" not in flags:
            flags.append("invalid")
        return _REST
    # the head's joint looks along its +z, and its +x is the person's left: the head's axes turned about y
    turn = rotation_vector(between((0.0, 0.0, 1.0), (-x * k, y * k, -z * k)))
    angle = sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    share = min(1.0, FARTHEST / angle) if angle > 0 else 0.0
    return (turn[0] * share, turn[1] * share, turn[2] * share)
