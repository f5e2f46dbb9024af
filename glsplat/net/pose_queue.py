"""PoseQueue: solves one client's tracking on a thread, sample by sample as it arrives, while the renderer draws.

The filter needs all samples in order, so those of dropped requests are solved, too. Clients take turns, one sample
each. Of a client over its budget only the newest sample is solved, once its picture is due; each sample keeps its own
time. The expected cost is charged before solving, or a client could queue more than its budget while the thread lags.
A client that requests poses is treated the same way once its samples queue up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future
from threading import Lock
from time import thread_time

from glsplat.errors import PoseError
from glsplat.net.backend import PoseSolver, Solved
from glsplat.net.guard.limits import Bucket, CpuShare
from glsplat.net.messages import Request

_MAX_QUEUED = 32  # samples; the oldest are dropped
_MAX_QUEUED_POSES = 2  # samples of requests for poses
_INITIAL_COST_S = 1e-3  # expected time of a client's first sample
_COST_WEIGHT = 0.2  # of each sample in the moving average of their times

SolutionFuture = Future[tuple[Solved, float]]
"""A sample's solution, and the milliseconds that it took."""


class PoseQueue:
    """The samples of one client. ``thread`` runs one job at a time; many clients may share it."""

    def __init__(
        self,
        solver: PoseSolver,
        thread: Executor,
        clock: Callable[[], float],
        cpu: Callable[[], float] = thread_time,  # seconds the calling thread has worked
        share: CpuShare | None = None,  # of the time for solving; None: no limit
        samples: Bucket | None = None,  # solved one by one; None: no limit
    ) -> None:
        self.share: CpuShare | None = share
        self.samples: Bucket | None = samples
        self.on_solved: Callable[[Request, Solved, float], None] | None = None
        """Called on the solving thread with a solution and its sample's arrival (seconds); may raise PoseError."""
        self._cpu = cpu
        self.merged = 0  # samples dropped for a newer one, over the budget
        self._solver, self._thread, self._clock = solver, thread, clock
        self._solutions: deque[tuple[int | None, SolutionFuture]] = deque()  # by frame_id, oldest first
        self._cost = _INITIAL_COST_S  # seconds, expected of the next sample
        self._unsolved: deque[tuple[Request, float, SolutionFuture, float]] = deque()  # arrival and charged seconds
        self._due: int | None = None  # frame_id of the sample that a picture waits for
        self._put_off: tuple[Request, float] | None = None  # the newest sample, over the budget, and its arrival
        self._lock = Lock()  # over _unsolved and _running
        self._running = False  # the thread has a job of this queue

    def add(self, request: Request) -> None:
        """Queue the sample of an accepted request."""
        now = self._clock()
        self.merged += self._put_off is not None
        self._put_off = None
        if self._within_budget(request, now):
            self._queue(request, now)
        else:
            self._put_off = request, now

    def _within_budget(self, request: Request, now: float) -> bool:
        """Return whether a sample is solved at once; that takes one of ``samples``."""
        if request.poses and len(self._unsolved) >= _MAX_QUEUED_POSES:
            return False
        return (self.share is None or self.share.left(now)) and (self.samples is None or self.samples.take(now))

    def begin(self, frame_id: int | None, done: Callable[[], None]) -> None:
        """Solve the sample of this request whatever the budget, and call ``done`` afterwards, on any thread."""
        self._queue_put_off(frame_id)
        self._due = frame_id
        solution = self._find(frame_id)
        if solution is not None:
            solution.add_done_callback(lambda _: done())

    def solved(self, frame_id: int | None) -> bool:
        """Return whether ``take`` returns without a wait."""
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            return False
        solution = self._find(frame_id)
        return solution is None or solution.done()

    def take(self, frame_id: int | None) -> SolutionFuture | None:
        """Return the solution of a request, done or under way; forget those of older requests."""
        self._queue_put_off(frame_id)
        self._due = None
        while self._solutions:
            number, solution = self._solutions.popleft()
            if number == frame_id:
                return solution
        return None

    def clear(self) -> None:
        """Cancel all samples."""
        self._put_off = None
        while self._solutions:
            self._solutions.popleft()[1].cancel()

    def _spend(self, seconds: float) -> None:
        if self.share is not None:
            self.share.spend(seconds)

    def _find(self, frame_id: int | None) -> SolutionFuture | None:
        return next((solution for number, solution in reversed(self._solutions) if number == frame_id), None)

    def _queue_put_off(self, frame_id: int | None) -> None:
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            self._queue(*self._put_off)
            self._put_off = None

    def _queue(self, request: Request, now: float) -> None:
        solution: SolutionFuture = Future()
        self._solutions.append((request.frame_id, solution))
        cost = self._cost
        self._spend(cost)
        if len(self._solutions) > _MAX_QUEUED:
            oldest = 1 if self._solutions[0][0] == self._due else 0  # a picture waits for the first
            self._solutions[oldest][1].cancel()
            del self._solutions[oldest]
        with self._lock:
            while self._unsolved and self._unsolved[0][2].cancelled():
                self._spend(-self._unsolved.popleft()[3])
            self._unsolved.append((request, now, solution, cost))
            submit, self._running = not self._running, True
        if submit:
            self._thread.submit(self._solve_next)

    def _solve_next(self) -> None:
        """Solve the oldest sample on the thread, then queue again behind the other clients."""
        solution = None
        while solution is None:
            with self._lock:
                if not self._unsolved:
                    self._running = False
                    return
                request, arrived, oldest, cost = self._unsolved.popleft()
            if oldest.set_running_or_notify_cancel():
                solution = oldest
            else:
                self._spend(-cost)
        start, worked = self._clock(), self._cpu()
        try:
            if request.fault:
                raise PoseError(request.fault)
            result = self._solver.solve(request, arrived)
            if self.on_solved is not None:
                self.on_solved(request, result, arrived)
        except BaseException as error:  # an error must not end the client's queue
            solution.set_exception(error)
        else:
            solution.set_result((result, (self._clock() - start) * 1e3))
        took = self._cpu() - worked
        self._spend(took - cost)
        self._cost += _COST_WEIGHT * (took - self._cost)
        try:
            self._thread.submit(self._solve_next)
        except RuntimeError:  # the server stops
            with self._lock:
                self._running = False
                while self._unsolved:
                    self._unsolved.popleft()[2].cancel()
