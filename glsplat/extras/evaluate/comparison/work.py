"""The work of a comparison: make, drive, draw and measure each method's avatar of one participant, in processes.

Finished work is kept in the output folder and not repeated: ``avatars/METHOD/NAME.glb``, ``results/METHOD/NAME.json``,
``sheets/METHOD/NAME.jpg``. A result is written atomically, once it is complete.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.errors import GlsplatError, one_line
from glsplat.extras.evaluate.comparison.measure import Reference, Scores
from glsplat.extras.evaluate.comparison.method import MadeElsewhere, key_of, product
from glsplat.extras.evaluate.comparison.participant import Participant
from glsplat.extras.evaluate.comparison.protocol import (
    Protocol,
    perform,
    perform_motion,
    recorded,
    tracked,
    true_poses,
)
from glsplat.extras.evaluate.comparison.stage import Stage
from glsplat.io.files import replace_file
from glsplat.io.provenance import commit
from glsplat.renderer import Renderer
from glsplat.scene import Rigged
from glsplat.skinning.pose import Pose

Picture = NDArray[np.uint8]
_SIDE = 192  # height of a picture of a contact sheet, pixels
_STRIP = 18  # height of the heading of its rows, pixels
_QUALITY = 85  # of its JPEG

Tell = Callable[[str, float], None]  # called with a step's name and the finished share of the task

_Product = tuple[Rigged, dict[str, Any]]
_MAKING = 0.5  # approximate share of a task's time for making avatars
_DIGITS = 6

log: logging.Logger = logging.getLogger("glsplat.extras.evaluate")

Show = Callable[[int, str, float], None]
"""Called with a task's index, its current step, and its finished share."""

# one thread per worker, as the last bits of sums depend on the number of threads
_ONE_CORE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "LP_NUM_THREADS": "1"}


class Sheet:
    """Small pictures in named rows and a column per moment; rows are in the order of their first picture."""

    def __init__(self, moments: int) -> None:
        self._moments = moments
        self._rows: dict[str, list[Picture | None]] = {}

    def put(self, row: str, moment: int, picture: Picture) -> None:
        """Add a picture [H, W, 3 or 4] RGB(A)."""
        cells = self._rows.setdefault(row, [None] * self._moments)
        height, width = picture.shape[:2]
        size = (round(_SIDE * width / height), _SIDE)
        cells[moment] = cv2.resize(picture[..., :3], size, interpolation=cv2.INTER_AREA)

    def jpeg(self) -> bytes:
        """Return the sheet with its rows' names as a JPEG."""
        lines = []
        for name, cells in self._rows.items():
            filled = [np.zeros((_SIDE, _SIDE, 3), np.uint8) if cell is None else cell for cell in cells]
            line = np.hstack(filled)
            strip = np.full((_STRIP, line.shape[1], 3), 64, np.uint8)
            cv2.putText(strip, name, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
            lines += [strip, line]
        data = cv2.imencode(".jpg", np.vstack(lines)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        return bytes(data.tobytes())


@dataclass(frozen=True, eq=False)
class Task:
    """One participant and the methods that have no result yet."""

    participant: Participant
    methods: Mapping[str, str | MadeElsewhere]  # ``source`` of ``product``, by name
    protocol: Protocol
    out: Path
    options: Mapping[str, Any] = field(default_factory=dict)  # seed, quick: of the project's own methods


@dataclass(frozen=True, eq=False)
class Result:
    """One method on one participant: ``failed`` is one line; "" if there are values."""

    participant: str
    method: str
    failed: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)
    """product (see ``product``), moments, views, values {control: {measure: [M][V][2]}}, parts {control: {part:
    {measure: [M][V][2], null where it is not visible}}}."""


def finished(task: Task) -> list[Result]:
    """Return the results in the folder that are valid for this task's protocol, options and files."""
    found = []
    for method in task.methods:
        try:
            kept = json.loads(_result_file(task, method).read_text(encoding="utf-8"))
            if kept["key"] == _key(task, method) and _sheet_file(task, method).is_file():
                found.append(Result(task.participant.name, method, data=kept["data"]))
        except (GlsplatError, OSError, ValueError, KeyError, TypeError):
            continue  # it is made again, which reports any error
    return found


def alone(task: Task) -> list[Result]:
    """Do a task without reporting progress, on another machine."""
    return work(task, lambda step, done: None)


def work(task: Task, tell: Tell) -> list[Result]:
    """Do a task and return one result per method; a failed one has the reason and is retried in the next run."""
    name = task.participant.name
    made: dict[str, _Product] = {}
    results = []
    for index, (method, source) in enumerate(task.methods.items()):
        tell(f"{name}: {method}", _MAKING * index / len(task.methods))
        try:
            folder = task.out / "avatars" / method
            made[method] = product(method, source, task.participant, folder, task.options)
        except Exception as error:
            results.append(Result(name, method, _said(error)))
    if not made:
        return results
    try:
        drawn = _drawn(task, made, tell)
    except Exception as error:
        return results + [Result(name, method, _said(error)) for method in made]
    for method, (data, sheet) in drawn.items():
        if isinstance(data, str):
            results.append(Result(name, method, data))
            continue
        try:
            _write(_sheet_file(task, method), sheet.jpeg())
            stored = json.dumps({"key": _key(task, method), "data": data}).encode()
            _write(_result_file(task, method), stored)
            results.append(Result(name, method, data=json.loads(stored)["data"]))
        except Exception as error:
            results.append(Result(name, method, _said(error)))
    return results


def _said(error: Exception) -> str:
    """Return one line for an error; unexpected ones are logged with their traceback."""
    if isinstance(error, GlsplatError):
        return str(error)
    log.error("a comparison failed", exc_info=error)
    return one_line(error)


def _drawn(task: Task, made: Mapping[str, _Product], tell: Tell) -> dict[str, tuple[dict[str, Any] | str, Sheet]]:
    """Return each method's values, or the reason of its failure, and its contact sheet."""
    protocol, mesh = task.protocol, task.participant.mesh
    performance = perform(mesh, protocol.tasks)
    if protocol.motion is not None:
        performance = perform_motion(protocol.motion, mesh.skeleton, protocol.moments)
    moments = len(performance.moments)
    samples = recorded(performance, mesh.skeleton)
    entries: dict[str, _Entry] = {}
    out: dict[str, tuple[dict[str, Any] | str, Sheet]] = {}
    with Stage(mesh, performance, protocol, task.participant.light) as stage:
        for method, (figure, _) in made.items():
            try:
                skeleton = figure.skeleton
                poses = {  # in the order of CONTROLS
                    "tracking": tracked(samples, performance.moments, skeleton),
                    "pose": true_poses(performance, mesh.skeleton, skeleton),
                }
                entries[method] = _Entry(stage.add(figure), poses, Scores(protocol, moments), Sheet(moments))
            except Exception as error:
                out[method] = _said(error), Sheet(moments)
        pictures = list(np.ndindex(moments, len(protocol.views))) if entries else []
        for index, (moment, view) in enumerate(pictures):
            tell(f"{task.participant.name}: pictures", _MAKING + (1 - _MAKING) * index / len(pictures))
            reference = Reference.of(stage.truth(moment, protocol.views[view]), protocol)
            for method, entry in list(entries.items()):
                try:
                    _compare(entry, reference, moment, view, protocol.views)
                except Exception as error:  # the other avatars go on
                    out[method] = _said(error), entry.sheet
                    del entries[method]
        for method, entry in entries.items():
            data = {
                "product": made[method][1],
                "driver": stage.driver,
                "made_by": f"{version('glsplat')}, commit {commit() or 'unknown'}",
                "moments": list(performance.names),
                "views": list(protocol.views),
                **entry.scores.to_json(_DIGITS),
            }
            out[method] = data, entry.sheet
    return out


def _compare(entry: _Entry, reference: Reference, moment: int, view: int, views: Sequence[str]) -> None:
    """Draw an avatar under both controls with the truth's cameras, and measure it."""
    side, shown = views[view], view in (0, len(views) // 2)  # front and back, if there are all four
    if shown:
        entry.sheet.put(f"{side}: participant", moment, reference.truth.pictures[0])
    for control, poses in entry.poses.items():
        pictures = entry.renderer.render(reference.truth.cameras, poses[moment])
        entry.scores.add(control, moment, view, reference, pictures)
        if shown:
            entry.sheet.put(f"{side}: by {control}", moment, pictures[0])


@dataclass(frozen=True, eq=False)
class _Entry:
    """One avatar on the stage."""

    renderer: Renderer
    poses: Mapping[str, list[Pose]]  # by control
    scores: Scores
    sheet: Sheet


def _key(task: Task, method: str) -> dict[str, Any]:
    """Return a result's inputs besides the code. Raises GlsplatError for missing files."""
    source = key_of(task.methods[method], task.participant)
    return {"protocol": task.protocol.to_json(), "options": dict(task.options), **source}


def _sheet_file(task: Task, method: str) -> Path:
    return task.out / "sheets" / method / f"{task.participant.name}.jpg"


def _result_file(task: Task, method: str) -> Path:
    return task.out / "results" / method / f"{task.participant.name}.json"


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, [data])


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
                    task, code = tasks[index], process.exitcode or 0
                    how = f"signal {-code}" if code < 0 else f"exit code {process.exitcode}"
                    why = f"the process that worked on {task.participant.name} ended ({how}); memory may have run out"
                    said = [Result(task.participant.name, method, why) for method in task.methods]
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
