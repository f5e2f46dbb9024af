"""One client's tracking, solved sample by sample as it arrives: while the renderer is busy, not before it draws again.

A filter wants all samples in their order, whatever the frame rate, so requests that are never drawn are solved too.
Clients take turns, one sample each. A client beyond its budget has only its newest sample solved, once a picture of it
is due: the filter sees a coarser, honest series, each sample at its own time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from threading import Lock
from time import thread_time

from glsplat.net.backend import PoseSolver, Solved
from glsplat.net.guard.limits import Bucket, Share
from glsplat.net.messages import RenderRequest

__all__ = ["Solution", "Solving"]

_MOST = 32  # samples that wait to be solved; beyond that the oldest are left out

Solution = Future[tuple[Solved, float]]
"""What a sample comes to, and the milliseconds that took."""


class Solving:
    """The samples of one client. ``thread`` has to work one job at a time; it may be shared by many clients."""

    def __init__(
        self,
        solver: PoseSolver,
        thread: Executor,
        clock: Callable[[], float],
        cpu: Callable[[], float] = thread_time,  # seconds the calling thread has worked
    ) -> None:
        self.share: Share | None = None  # of the time for solving; None: no limit
        self.samples: Bucket | None = None  # solved one by one; None: no limit
        self._cpu = cpu
        self.merged = 0  # samples left out in favour of a newer one, the budget being spent
        self._solver, self._thread, self._clock = solver, thread, clock
        self._solutions: deque[tuple[int | None, Solution]] = deque()  # by frame_id, oldest first
        self._unsolved: deque[tuple[RenderRequest, float, Solution]] = deque()  # of those, oldest first
        self._put_off: tuple[RenderRequest, float] | None = None  # the newest sample, beyond the budget
        self._lock = Lock()  # over _unsolved and _running
        self._running = False  # a job of ours is with the thread

    def add(self, request: RenderRequest) -> None:
        """A request with tracking was accepted."""
        now = self._clock()
        self.merged += self._put_off is not None
        self._put_off = None
        within = self.share is None or self.share.left(now)
        if within and (self.samples is None or self.samples.take(now)):
            self._queue(request, now)
        else:
            self._put_off = request, now

    def take(self, frame_id: int | None) -> Solution | None:
        """The solution of a request, done or under way; those of older requests are forgotten."""
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            self._queue(*self._put_off)
            self._put_off = None
        while self._solutions:
            number, solution = self._solutions.popleft()
            if number == frame_id:
                return solution
        return None

    def clear(self) -> None:
        """The client left."""
        self._put_off = None
        while self._solutions:
            self._solutions.popleft()[1].cancel()

    def _queue(self, request: RenderRequest, now: float) -> None:
        solution: Solution = Future()
        self._solutions.append((request.frame_id, solution))
        if len(self._solutions) > _MOST:
            self._solutions.popleft()[1].cancel()
        with self._lock:
            while self._unsolved and self._unsolved[0][2].cancelled():
                self._unsolved.popleft()
            self._unsolved.append((request, now, solution))
            submit, self._running = not self._running, True
        if submit:
            self._thread.submit(self._solve_next)

    def _solve_next(self) -> None:
        """On the solving thread: the oldest sample, then to the end of the line behind the other clients."""
        solution = None
        while solution is None:
            with self._lock:
                if not self._unsolved:
                    self._running = False
                    return
                request, arrived, oldest = self._unsolved.popleft()
            if oldest.set_running_or_notify_cancel():
                solution = oldest
        start, worked = self._clock(), self._cpu()
        try:
            result = self._solver.solve(request, arrived * 1e3)
        except BaseException as error:
            solution.set_exception(error)
        else:
            solution.set_result((result, (self._clock() - start) * 1e3))
        if self.share is not None:
            self.share.spend(self._cpu() - worked)
        try:
            self._thread.submit(self._solve_next)
        except RuntimeError:  # the server stops
            with self._lock:
                self._running = False
                while self._unsolved:
                    self._unsolved.popleft()[2].cancel()
