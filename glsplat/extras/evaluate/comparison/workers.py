"""Run each task in a process and collect progress and results; a dead process becomes a failed result."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from glsplat.extras.evaluate.comparison.work import Result, Task, work

Show = Callable[[int, str, float], None]
"""Called with a task's index, its current step, and its finished share."""

# one thread per worker, as the last bits of sums depend on the number of threads
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}


def run_tasks(tasks: Sequence[Task], jobs: int, show: Show) -> Iterator[list[Result]]:
    """Yield the results of each task as it finishes, from at most ``jobs`` processes at a time.

    Each task, even a single one, has its own process, so that all run alike. Processes that still run when the caller
    stops are terminated.
    """
    context = multiprocessing.get_context("spawn")
    waiting = list(range(len(tasks)))
    running: dict[Connection, tuple[int, BaseProcess]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                index = waiting.pop(0)
                ours, theirs = context.Pipe(duplex=False)
                worker: BaseProcess = context.Process(target=_work, args=(tasks[index], theirs))
                with _environment(_ONE_CORE):
                    worker.start()
                theirs.close()  # so that recv() raises EOFError when the process ends
                running[ours] = index, worker
            for connection in wait(list(running)):
                assert isinstance(connection, Connection)
                index, process = running[connection]
                try:
                    said: tuple[str, float] | list[Result] = connection.recv()
                except (EOFError, OSError):
                    process.join()
                    said = _lost(tasks[index], process.exitcode)
                if isinstance(said, tuple):
                    show(index, *said)
                    continue
                del running[connection]
                connection.close()
                process.join()
                yield said
    finally:
        for _, process in running.values():
            process.terminate()
        for connection, (_, process) in running.items():
            process.join()
            connection.close()


def _work(task: Task, said: Connection) -> None:
    """Run one task in a worker process."""
    import cv2

    cv2.setNumThreads(1)
    parent = multiprocessing.parent_process()

    def tell(step: str, done: float) -> None:
        if parent is not None and not parent.is_alive():
            os._exit(1)
        said.send((step, done))

    said.send(work(task, tell))


def _lost(task: Task, code: int | None) -> list[Result]:
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    why = f"the process that worked on {task.participant.name} ended ({how}); memory may have run out"
    return [Result(task.participant.name, method, why) for method in task.methods]


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables and ignore Ctrl-C in processes that are started within.

    This process handles Ctrl-C and ends its workers, which would otherwise each print a traceback.
    """
    before: dict[str, Any] = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN)  # inherited by new processes
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, heard)
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
