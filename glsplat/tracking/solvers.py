"""Solvers by name, and the embedded network."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources
from typing import Literal

from glsplat.errors import PoseError
from glsplat.tracking.learned.network import PoseNetwork, load_network
from glsplat.tracking.learned.solver import LearnedSolver
from glsplat.tracking.solve.body import Body
from glsplat.tracking.solve.solution import Solver
from glsplat.tracking.solve.solver import AnalyticSolver

__all__ = ["SOLVERS", "SolverName", "embedded_network", "solver_of"]

SolverName = Literal["analytic", "learned"]
SOLVERS: tuple[SolverName, ...] = ("learned", "analytic")


@lru_cache(maxsize=1)
def embedded_network() -> PoseNetwork:
    """The network that comes with the package; docs/tracking.md says what it learned from.

    Raises FormatError where the file is damaged.
    """
    with resources.as_file(resources.files("glsplat.data") / "tracking.npz") as path:
        return load_network(path)


def solver_of(solver: Solver | SolverName | None, body: Body) -> Solver:
    """A solver by name ("learned" for None), or the one given. Raises PoseError for what is neither."""
    if solver == "analytic":
        return AnalyticSolver(body)
    if solver is None or solver == "learned":
        return LearnedSolver(body, embedded_network())
    if isinstance(solver, str):
        raise PoseError(f"a solver is one of {', '.join(SOLVERS)}, or an object of your own, not {solver!r:.60}")
    if not all(callable(getattr(solver, name, None)) for name in ("reset", "solve")):
        raise PoseError(
            f"a solver needs the methods reset() and solve(targets, dt), which {type(solver).__name__} lacks"
        )
    return solver
