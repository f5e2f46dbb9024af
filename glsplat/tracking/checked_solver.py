"""The stage of a Tracker that runs the solver and checks its Solution: finite numbers, rotations inside the limits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from math import isfinite, sqrt
from typing import Any

from glsplat.errors import PoseError
from glsplat.tracking.judge import MAX_DISTANCE_M, within_range
from glsplat.tracking.solve.body import PELVIS, Body
from glsplat.tracking.solve.limits import clamp_joint
from glsplat.tracking.solve.quat import IDENTITY, Quat, Vec
from glsplat.tracking.solve.solution import Solution, Solver, Targets

JOINT_COUNT = 22  # of the body, the root first
UNIT_TOLERANCE = 1e-6  # of |q|^2: rounding
MAX_STEP_S = 0.1  # of a solver; longer gaps are solved in several steps
MAX_ERROR_CHARS = 300

log: logging.Logger = logging.getLogger("glsplat.tracking")


class CheckedSolver:
    """Run a solver that may raise or return nonsense."""

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        self._keeps_limits = getattr(type(solver), "keeps_limits", False)
        self.error = ""  # why the last call gave no solution; one line

    def reset(self) -> None:
        """Forget the past."""
        self.solver.reset()
        self.error = ""

    def update(self, targets: Targets, dt: float, restart: bool) -> Solution | None:
        """Return the solver's checked body; None where it failed."""
        try:
            if restart:
                self.solver.reset()
            solution = self.solver.solve(targets, min(dt, MAX_STEP_S))
            for _ in range(int(dt / MAX_STEP_S - 1e-9)):  # a hole of some tenths of a second: let the body settle
                solution = self.solver.solve(targets, MAX_STEP_S)
            # a solver of this package keeps joint limits exactly; checking them again could change the last bit
            if not (self._keeps_limits and _finite(solution)):
                solution = checked(solution)
        except Exception as error:
            if not self.error:  # once, not at every sample
                log.warning("%s failed; holding the last pose", type(self.solver).__name__, exc_info=True)
            text = str(error) if isinstance(error, PoseError) else f"{type(error).__name__}: {error}"
            self.error = " ".join(text.split())[:MAX_ERROR_CHARS]
            return None
        self.error = ""
        return solution


def checked(solution: Any) -> Solution:
    """Return a copy with 22 unit quaternions inside the joints' limits. Raises PoseError where that is impossible.

    A copy, because a solver may return the same object each time, and the guard remembers the last one.
    """
    if not isinstance(solution, Solution):
        raise PoseError(f"a solver returns a Solution, not {type(solution).__name__}")
    try:
        rotations = [
            _rotation(joint, q) for joint, q in enumerate(_counted(solution.rotations, JOINT_COUNT, "rotations"))
        ]
        pelvis = _position(solution.pelvis, "pelvis")
        left, right = _counted(solution.reach, 2, "reach")
        planted = _counted(solution.planted, 2, "planted")
        a, b = _counted(solution.feet, 2, "feet")
        if isinstance(solution.notes, str) or not all(isinstance(note, str) for note in solution.notes):
            raise PoseError("a solution's notes are a list of strings")
        given = solution.expected_error
        counted = _counted(given, JOINT_COUNT, "expected_error") if len(given) else ()
        errors = tuple([_number(error, "expected_error") for error in counted])
        if errors and min(errors) < 0:
            raise PoseError("a solution's expected_error needs metres of 0 or more")
        return Solution(
            rotations,
            pelvis,
            (_number(left, "reach"), _number(right, "reach")),
            _number(solution.head_off, "head_off"),
            (bool(planted[0]), bool(planted[1])),
            bool(solution.airborne),
            list(solution.notes),
            (None if a is None else _position(a, "feet"), None if b is None else _position(b, "feet")),
            errors,
        )
    except (TypeError, ValueError, OverflowError) as error:  # not numbers, not sequences
        raise PoseError(f"expected a glsplat.tracking.Solution ({error})") from None


def repeated(last: Solution) -> Solution:
    """Return the last body once more, where there is no new one."""
    return Solution([*last.rotations], last.pelvis, planted=last.planted, airborne=last.airborne, feet=last.feet)


def zero_pose(body: Body) -> Solution:
    """Return the zero pose, where there is no last body either."""
    return Solution([IDENTITY] * JOINT_COUNT, body.joints[PELVIS])


def _finite(solution: Solution) -> bool:
    """Return whether every number of a solution of the right form is finite; quick."""
    x, y, z = solution.pelvis
    total = x + y + z + solution.reach[0] + solution.reach[1] + solution.head_off + sum(solution.expected_error)
    for a, b, c, d in solution.rotations:
        total += a + b + c + d
    for foot in solution.feet:
        if foot is not None:
            total += foot[0] + foot[1] + foot[2]
    return isfinite(total)


def _counted(values: Any, count: int, name: str) -> Sequence[Any]:
    if len(values) != count:
        raise PoseError(f"a solution's {name} needs {count} entries, not {len(values)}")
    return values


def _rotation(joint: int, q: Any) -> Quat:
    w, x, y, z = q
    n = w * w + x * x + y * y + z * z
    if not 1e-8 < n < 1e8:  # NaN fails this too
        raise PoseError(f"a solution's rotation of joint {joint} is not a quaternion: {q!s:.80}")
    k = 1.0 if -UNIT_TOLERANCE < n - 1 < UNIT_TOLERANCE else 1 / sqrt(n)
    turn = (float(w) * k, float(x) * k, float(y) * k, float(z) * k)
    return turn if joint == PELVIS else clamp_joint(joint, turn)


def _position(position: Any, name: str) -> Vec:
    x, y, z = position
    if not within_range(x, y, z):
        raise PoseError(f"a solution's {name} needs metres within {MAX_DISTANCE_M:g}, not {position!s:.80}")
    return (float(x), float(y), float(z))


def _number(value: Any, name: str) -> float:
    number = float(value)
    if not isfinite(number):
        raise PoseError(f"a solution's {name} needs a finite number, not {number}")
    return number
