"""Solvers by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from glsplat.errors import PoseError
from glsplat.optional import extra_module, has_extra

if TYPE_CHECKING:
    from glsplat.tracking.solve.body import Body
    from glsplat.tracking.solve.solution import Solver

SolverName = Literal["analytic", "learned"]


SOLVERS: tuple[SolverName, ...] = ("learned", "analytic") if has_extra("learned") else ("analytic",)
"""Solvers that are installed, the default first."""


def solver_of(solver: Solver | SolverName | None, body: Body) -> Solver:
    """Return a solver by name, or the one given; None: the first of ``SOLVERS``. Raises PoseError for neither."""
    name = SOLVERS[0] if solver is None else solver
    if isinstance(name, str) and name not in SOLVERS:
        raise PoseError(f"a solver is one of {', '.join(SOLVERS)}, or an object of your own, not {name!r:.60}")
    if name == "analytic":
        from glsplat.tracking.solve.solver import AnalyticSolver  # here: a command's options name solvers only

        return AnalyticSolver(body)
    if name == "learned":
        learned: Solver = extra_module("learned.solver").LearnedSolver(body)
        return learned
    if not all(callable(getattr(name, method, None)) for method in ("reset", "solve")):
        raise PoseError(f"a solver needs the methods reset() and solve(targets, dt), which {type(name).__name__} lacks")
    return name
