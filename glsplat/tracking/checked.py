"""What a solver says, before it is used: a Solution of finite numbers, or a PoseError that says why not."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Any

from glsplat.errors import PoseError
from glsplat.tracking.solve.body import PELVIS
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec
from glsplat.tracking.solve.solution import Solution

__all__ = ["checked", "finite", "standing", "still"]

JOINTS = 22  # of the body, the root first
FAR = 1e4  # metres
UNIT = 1e-6  # |q|^2 - 1 that is rounding


def checked(solution: Any) -> Solution:
    """A copy with 22 unit quaternions inside the joints' limits. Raises PoseError for what cannot be one.

    A copy, because a solver may return the same object each time, and the guard remembers the last one.
    """
    if not isinstance(solution, Solution):
        raise PoseError(f"a solver returns a Solution, not {type(solution).__name__}")
    try:
        rotations = [_rotation(joint, q) for joint, q in enumerate(_all(solution.rotations, JOINTS, "rotations"))]
        pelvis = _place(solution.pelvis, "pelvis")
        left, right = _all(solution.reach, 2, "reach")
        planted = _all(solution.planted, 2, "planted")
        a, b = _all(solution.feet, 2, "feet")
        if isinstance(solution.notes, str) or not all(isinstance(note, str) for note in solution.notes):
            raise PoseError("a solution's notes are a list of strings")
        return Solution(
            rotations,
            pelvis,
            (_number(left, "reach"), _number(right, "reach")),
            _number(solution.head_off, "head_off"),
            (bool(planted[0]), bool(planted[1])),
            bool(solution.airborne),
            list(solution.notes),
            (None if a is None else _place(a, "feet"), None if b is None else _place(b, "feet")),
            _expected(solution.expected_error),
        )
    except (TypeError, ValueError, OverflowError) as error:  # not numbers, not sequences
        raise PoseError(f"a solution of another form than glsplat.tracking.Solution ({error})") from None


def finite(solution: Solution) -> bool:
    """Whether every number is; quick, for solutions of the right form."""
    x, y, z = solution.pelvis
    total = x + y + z + solution.reach[0] + solution.reach[1] + solution.head_off
    for a, b, c, d in solution.rotations:
        total += a + b + c + d
    for foot in solution.feet:
        if foot is not None:
            total += foot[0] + foot[1] + foot[2]
    total += sum(solution.expected_error)
    return isfinite(total)


def still(last: Solution) -> Solution:
    """The last body once more, where there is no new one."""
    return Solution([*last.rotations], last.pelvis, (0.0, 0.0), 0.0, last.planted, last.airborne, [], last.feet)


def standing(pelvis: Vec) -> Solution:
    """The zero pose, where there never was one."""
    return Solution([IDENTITY] * JOINTS, pelvis)


def _all(values: Any, count: int, name: str) -> Sequence[Any]:
    if len(values) != count:
        raise PoseError(f"a solution's {name} needs {count} entries, not {len(values)}")
    return values


def _rotation(joint: int, q: Any) -> Quat:
    w, x, y, z = q
    n = w * w + x * x + y * y + z * z
    if not 1e-8 < n < 1e8:  # NaN fails this too
        raise PoseError(f"a solution's rotation of joint {joint} is no quaternion: {q!s:.80}")
    k = 1.0 if -UNIT < n - 1 < UNIT else 1 / sqrt(n)
    turn = (float(w) * k, float(x) * k, float(y) * k, float(z) * k)
    return turn if joint == PELVIS else clamp_joint(joint, turn)


def _place(place: Any, name: str) -> Vec:
    x, y, z = place
    if not (-FAR < x < FAR and -FAR < y < FAR and -FAR < z < FAR):
        raise PoseError(f"a solution's {name} needs metres within {FAR:g}, not {place!s:.80}")
    return (float(x), float(y), float(z))


def _expected(values: Any) -> tuple[float, ...]:
    if len(values) == 0:
        return ()
    metres = tuple([_number(value, "expected_error") for value in _all(values, JOINTS, "expected_error")])
    if min(metres) < 0:
        raise PoseError("a solution's expected_error needs metres of 0 or more")
    return metres


def _number(value: Any, name: str) -> float:
    number = float(value)
    if not isfinite(number):
        raise PoseError(f"a solution's {name} needs a finite number, not {number}")
    return number
