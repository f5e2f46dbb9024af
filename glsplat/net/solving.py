"""One client's tracking, solved sample by sample as it arrives: while the renderer is busy, not before it draws again.

A filter wants all samples in their order, whatever the frame rate, so requests that are never drawn are solved too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future

from glsplat.net.backend import PoseSolver, Solved
from glsplat.net.messages import RenderRequest

__all__ = ["Solution", "Solving"]

_MOST = 32  # samples that wait to be solved; beyond that the oldest are left out

Solution = Future[tuple[Solved, float]]
"""What a sample comes to, and the milliseconds that took."""


class Solving:
    """The samples of one client. ``thread`` has to work one job at a time; it may be shared by many clients."""

    def __init__(self, solver: PoseSolver, thread: Executor, clock: Callable[[], float]) -> None:
        self._solver, self._thread, self._clock = solver, thread, clock
        self._solutions: deque[tuple[int | None, Solution]] = deque()  # by frame_id, oldest first

    def add(self, request: RenderRequest) -> None:
        """A request with tracking was accepted."""
        self._solutions.append((request.frame_id, self._thread.submit(self._solve, request, self._clock())))
        if len(self._solutions) > _MOST:
            self._solutions.popleft()[1].cancel()

    def take(self, frame_id: int | None) -> Solution | None:
        """The solution of a request, done or under way; those of older requests are forgotten."""
        while self._solutions:
            number, solution = self._solutions.popleft()
            if number == frame_id:
                return solution
        return None

    def clear(self) -> None:
        """The client left."""
        while self._solutions:
            self._solutions.popleft()[1].cancel()

    def _solve(self, request: RenderRequest, now: float) -> tuple[Solved, float]:
        start = self._clock()
        solved = self._solver.solve(request, now * 1e3)
        return solved, (self._clock() - start) * 1e3
