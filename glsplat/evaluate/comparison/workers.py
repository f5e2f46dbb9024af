"""Workers: tasks in several processes, their progress and results in one; what a worker dies of is a result."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from glsplat.evaluate.comparison.work import Result, Task, work

__all__ = ["run_tasks"]

Show = Callable[[int, str, float], None]
"""Called with a task's place, what is being done of it, and the share of it that is done."""

# a worker is a core: libraries that start threads of their own would share it with the other workers
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}
_POLL = 0.5  # seconds between looks at whether workers live


def run_tasks(tasks: Sequence[Task], jobs: int, show: Show) -> Iterator[list[Result]]:
    """The results of each task, as they come. ``jobs`` processes; with one, everything happens in this one.

    Processes that are left when the caller stops are ended.
    """
    if jobs <= 1:
        for index, task in enumerate(tasks):
            yield work(task, lambda step, done, index=index: show(index, step, done))  # type: ignore[misc]
        return
    context = multiprocessing.get_context("spawn")
    said: multiprocessing.Queue[Any] = context.Queue()
    waiting = list(range(len(tasks)))
    running: dict[int, multiprocessing.process.BaseProcess] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                index = waiting.pop(0)
                with _environment(_ONE_CORE):
                    running[index] = context.Process(target=_work, args=(index, tasks[index], said), daemon=True)
                    running[index].start()
            try:
                kind, index, value = said.get(timeout=_POLL)
            except queue.Empty:
                for index, process in [(i, p) for i, p in running.items() if not p.is_alive() and said.empty()]:
                    del running[index]
                    yield _lost(tasks[index], process.exitcode)
                continue
            if index not in running:
                continue  # said before it was given up
            if kind == "step":
                show(index, *value)
            else:
                running.pop(index).join()
                yield value
    finally:
        for process in running.values():
            process.terminate()
        for process in running.values():
            process.join()


def _work(index: int, task: Task, said: multiprocessing.Queue[Any]) -> None:
    """A worker's whole life: one task."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears it, too, and ends its workers
    import cv2

    cv2.setNumThreads(1)
    parent = multiprocessing.parent_process()

    def tell(step: str, done: float) -> None:
        if parent is not None and not parent.is_alive():
            os._exit(1)  # nobody waits for this any more
        said.put(("step", index, (step, done)))

    said.put(("done", index, work(task, tell)))


def _lost(task: Task, code: int | None) -> list[Result]:
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    why = f"the process that worked on {task.participant.name} ended ({how}); memory may have run out"
    return [Result(task.participant.name, method, why) for method in task.methods]


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """The environment with these values where it has none, for processes that are started within."""
    added = [name for name in values if name not in os.environ]
    os.environ.update({name: values[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
