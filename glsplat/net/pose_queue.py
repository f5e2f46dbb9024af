"""One client's tracking, solved sample by sample as it arrives: while the renderer is busy, not before it draws again.

A filter wants all samples in their order, whatever the frame rate, so requests that are never drawn are solved too.
Clients take turns, one sample each. A client beyond its budget has only its newest sample solved, once a picture of it
is due: the filter sees a coarser, honest series, each sample at its own time. What a sample will cost is spent before
it is solved, else a client could queue more than its budget while the thread lags behind. Who draws itself, and is
answered in poses, is treated likewise when its samples pile up: it wants the newest, and nothing else holds it back.
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

__all__ = ["PoseQueue", "SolutionFuture"]

_MAX_QUEUED = 32  # samples that wait to be solved; beyond that the oldest are left out
_MAX_QUEUED_POSES = (
    2  # that wait of a client who draws: its answer comes as soon as its newest is solved, not when a picture is due
)
_INITIAL_COST_S = 1e-3  # seconds a sample is expected to take before any was solved ...
_COST_WEIGHT = 0.2  # ... and how far each one moves that

SolutionFuture = Future[tuple[Solved, float]]
"""What a sample comes to, and the milliseconds that took."""


class PoseQueue:
    """The samples of one client. ``thread`` has to work one job at a time; it may be shared by many clients."""

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
        """Called on the solving thread with a solution and the time of its sample (seconds); may raise PoseError."""
        self._cpu = cpu
        self.merged = 0  # samples left out in favour of a newer one, the budget being spent
        self._solver, self._thread, self._clock = solver, thread, clock
        self._solutions: deque[tuple[int | None, SolutionFuture]] = deque()  # by frame_id, oldest first
        self._cost = _INITIAL_COST_S  # seconds of work the next sample is expected to take
        self._unsolved: deque[tuple[Request, float, SolutionFuture, float]] = deque()  # and what was spent
        self._due: int | None = None  # frame_id of the sample that a picture waits for
        self._put_off: tuple[Request, float] | None = None  # the newest sample, beyond the budget
        self._lock = Lock()  # over _unsolved and _running
        self._running = False  # a job of ours is with the thread

    def add(self, request: Request) -> None:
        """A request with tracking was accepted."""
        now = self._clock()
        self.merged += self._put_off is not None
        self._put_off = None
        within = (self.share is None or self.share.left(now)) and not (
            request.poses and len(self._unsolved) >= _MAX_QUEUED_POSES
        )
        if within and (self.samples is None or self.samples.take(now)):
            self._queue(request, now)
        else:
            self._put_off = request, now

    def begin(self, frame_id: int | None, done: Callable[[], None]) -> None:
        """A picture of this request is due: its sample is solved now, whatever the budget. ``done``: on any thread."""
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            self._queue(*self._put_off)
            self._put_off = None
        self._due = frame_id
        solution = self._find(frame_id)
        if solution is not None:
            solution.add_done_callback(lambda _: done())

    def solved(self, frame_id: int | None) -> bool:
        """True once there is nothing to wait for in ``take``."""
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            return False
        solution = self._find(frame_id)
        return solution is None or solution.done()

    def take(self, frame_id: int | None) -> SolutionFuture | None:
        """The solution of a request, done or under way; those of older requests are forgotten."""
        if self._put_off is not None and self._put_off[0].frame_id == frame_id:
            self._queue(*self._put_off)
            self._put_off = None
        self._due = None
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

    def _spend(self, seconds: float) -> None:
        if self.share is not None:
            self.share.spend(seconds)

    def _find(self, frame_id: int | None) -> SolutionFuture | None:
        return next((solution for number, solution in reversed(self._solutions) if number == frame_id), None)

    def _queue(self, request: Request, now: float) -> None:
        solution: SolutionFuture = Future()
        self._solutions.append((request.frame_id, solution))
        cost = self._cost
        self._spend(cost)
        if len(self._solutions) > _MAX_QUEUED:
            oldest = 1 if self._solutions[0][0] == self._due else 0  # which is to be drawn
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
        """On the solving thread: the oldest sample, then to the end of the line behind the other clients."""
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
        except BaseException as error:  # else the client's queue would stop for good
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
