"""The face of a sample: how far eyes turn for a gaze, and weights of expressions that can be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite, sqrt

from glsplat.errors import PoseError
from glsplat.skinning.expression import checked_expression
from glsplat.tracking.judge import flag_invalid
from glsplat.tracking.sample import Sample
from glsplat.tracking.solve.quat import Vec, between, rotation_vector

MAX_EYE_TURN_RAD = 0.75  # 43 degrees: as far as an eye turns in its socket
_REST: Vec = (0.0, 0.0, 0.0)


def eye_turn(gaze: Sequence[float] | None, flags: list[str]) -> Vec:
    """Return the axis-angle of an eye that looks along ``gaze`` [3], of any length, in the head's axes (-z ahead).

    By the shortest way, without a roll (Listing's law), at most 43 degrees. A gaze without a direction leaves the eye
    at rest; one that is not three numbers is flagged "invalid" as well.
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
        flag_invalid(flags)
        return _REST
    # the head's joint looks along its +z, and its +x is the person's left: the head's axes turned about y
    turn = rotation_vector(between((0.0, 0.0, 1.0), (-x * k, y * k, -z * k)))
    angle = sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    k = min(1.0, MAX_EYE_TURN_RAD / angle) if angle > 0 else 0.0
    return (turn[0] * k, turn[1] * k, turn[2] * k)


def finite_expression(sample: Sample, flags: list[str]) -> Mapping[str, float]:
    """Return the sample's weights without those that are not finite; none where it has no valid expression."""
    if not sample.expression:
        return {}
    try:
        given = sample.expression.items()
        weights = {name: weight for name, weight in given if isfinite(weight)}
        expression, whole = checked_expression(weights), len(weights) == len(given)
    except (AttributeError, TypeError, ValueError, OverflowError, PoseError):  # not a mapping of numbers
        expression, whole = {}, False
    if not whole:
        flag_invalid(flags)
    return expression
