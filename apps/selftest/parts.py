"""The parts of a self-test, each run in a process of its own: a driver may end it."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from glsplat.data import default_avatar
from glsplat.errors import GlsplatError
from glsplat.extras.evaluate.costs import SIZES, costs
from glsplat.extras.evaluate.selftest.driver import context_cases, facts, frame_ms, largest_scene
from glsplat.extras.evaluate.selftest.paths import contract_cases
from glsplat.extras.evaluate.stability.frame import Case, Outcome, frame_cases, judge
from glsplat.extras.evaluate.stability.skin import skin_cases
from glsplat.extras.evaluate.subjects import Subject
from glsplat.gl.context import Context, create_context

from ..replay import latency

_SILENCE_S = 400.0  # without a word from a part before it is ended
_END_S = 10.0  # for a part to end after its last step
_RESTARTS = 3  # of a part that ends before its last step
_SECONDS_A_SIZE = {False: 30.0, True: 8.0}  # of the speed part; quick
_TOO_SLOW_MS = 3000.0  # a frame; above it nothing is measured
_RUNS_A_FRAME = 3  # of ``costs``, in frames of a pair
GOLDENS = ("tests/golden/test_goldens.py::test_golden", "tests/golden/test_contract.py::test_contract")

Tell = Callable[[str], None]


class Step(NamedTuple):
    """One step of a part: its label, and what returns its row."""

    label: str
    run: Callable[[], dict[str, Any]]


def _driver(quick: bool, tell: Tell) -> Iterator[Step]:
    context = create_context()
    yield Step("facts", lambda: facts(context))


def _contract(quick: bool, tell: Tell) -> Iterator[Step]:
    context = create_context()
    yield from _judged(contract_cases(context, quick), context)


def _hard(quick: bool, tell: Tell) -> Iterator[Step]:
    yield from _judged([*frame_cases(), *skin_cases()], create_context())


def _contexts(quick: bool, tell: Tell) -> Iterator[Step]:
    context = create_context()
    context.release()  # the cases make their own
    yield from _judged(context_cases(lambda share: tell(f"{share:.0%}")), context)


def _judged(cases: list[Case], context: Context) -> Iterator[Step]:
    for case in cases:
        yield Step(f"{case.name}: {case.input}", lambda case=case: judge([case], context)[0])  # type: ignore[misc]


def _goldens(quick: bool, tell: Tell) -> Iterator[Step]:
    root = Path(__file__).resolve().parents[2]
    if not all((root / test.partition("::")[0]).exists() for test in GOLDENS):
        return
    for test in GOLDENS[: 1 if quick else None]:
        yield Step(test, lambda test=test: judge([_pytest(root, test)], create_context())[0])  # type: ignore[misc]


def _pytest(root: Path, test: str) -> Case:
    def check(_: Context) -> Outcome:
        command = [sys.executable, "-m", "pytest", "-q", "-rf", "-p", "no:cacheprovider", test]
        done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
        lines = done.stdout.splitlines()
        failed = [line.split("::")[-1] for line in lines if line.startswith("FAILED")]
        return Outcome(done.returncode == 0, None, seen="; ".join(failed or lines[-1:] or [done.stderr[-300:]]))

    return Case("goldens", test.partition("::")[2], "images in the repository", "as docs/conventions.md, Gates", check)


def _speed(quick: bool, tell: Tell) -> Iterator[Step]:
    context, avatar = create_context(), default_avatar()

    def measured(size: int) -> dict[str, Any]:
        subject = Subject("default avatar, in motion", avatar, size, moving=True)
        one = frame_ms(context, subject, 1)
        if one > _TOO_SLOW_MS:
            return {"size": size, "left_out": f"a frame takes {one / 1000:.1f} s"}
        frames = int(min(60, max(3, 1000 * _SECONDS_A_SIZE[quick] / (_RUNS_A_FRAME * one))))
        return costs(context, {subject.name: avatar}, [size], frames)[0]

    for size in SIZES:
        yield Step(f"2 x {size}x{size}", lambda size=size: measured(size))  # type: ignore[misc]


def _stream(quick: bool, tell: Tell) -> Iterator[Step]:
    yield Step("raw tracking to JPEG", lambda: latency.measure(quick))


def _largest(quick: bool, tell: Tell) -> Iterator[Step]:
    context = create_context()
    yield Step("largest scene", lambda: largest_scene(context, frames=3 if quick else 9, tick=tell))


PARTS: dict[str, Callable[[bool, Tell], Iterator[Step]]] = {
    "driver": _driver,
    "contract": _contract,
    "hard": _hard,
    "contexts": _contexts,
    "goldens": _goldens,
    "speed": _speed,
    "stream": _stream,
    "largest": _largest,
}
"""Name -> steps, in the order in which they run; without steps a part is not possible here."""


def run_part(name: str, quick: bool, device: str | None, show: Tell = lambda text: None) -> dict[str, Any]:
    """Return {"seconds", "rows"} of a part. A step that ends the process is a failed row, and the next step follows."""
    rows: list[dict[str, Any]] = []
    start = time.perf_counter()
    for _ in range(1 + _RESTARTS):
        if _ends_well(name, quick, device, rows, show):
            break
    else:
        rows.append(_failed(name, "the rest", f"left out after {_RESTARTS} restarts"))
    return {"seconds": round(time.perf_counter() - start, 1), "rows": rows}


def _ends_well(name: str, quick: bool, device: str | None, rows: list[dict[str, Any]], show: Tell) -> bool:
    """Run a part from step ``len(rows)`` on and append its rows; return False if a step ended it, which failed."""
    processes = multiprocessing.get_context("spawn")
    ours, theirs = processes.Pipe(duplex=False)
    # no daemon, which could not start the server of the stream
    process = processes.Process(target=_child, args=(theirs, name, quick, device, len(rows)), name=f"selftest {name}")
    process.start()
    theirs.close()
    label = "start"
    try:
        while ours.poll(_SILENCE_S):
            kind, value = ours.recv()
            if kind == "done":
                process.join(_END_S)
                return True
            if kind == "row":
                rows.append(value)
            elif kind == "step":
                label = value
            show(f"{label} {value}" if kind == "tell" else label)
        reason = f"no word for {_SILENCE_S:g} s"
    except EOFError:
        process.join(_END_S)
        code = process.exitcode or 0
        reason = f"ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    finally:
        if process.is_alive():
            process.kill()
        process.join()
        ours.close()
    rows.append(_failed(name, label, reason))
    return False


def _child(connection: Connection, name: str, quick: bool, device: str | None, first: int) -> None:
    """Run the steps of a part from number ``first`` on."""
    faulthandler.enable()
    if device is not None:
        os.environ["GLSPLAT_DEVICE"] = device  # also of the processes that a step starts
    try:
        for step in list(PARTS[name](quick, lambda text: connection.send(("tell", text))))[first:]:
            connection.send(("step", step.label))
            connection.send(("row", _row(name, step)))
    except GlsplatError as error:  # no context, say
        connection.send(("row", _failed(name, "start", str(error))))
    connection.send(("done", None))


def _row(name: str, step: Step) -> dict[str, Any]:
    try:
        return step.run()
    except Exception as error:  # the report has to say so and go on
        return _failed(name, step.label, f"{type(error).__name__}: {error}")


def _failed(name: str, label: str, reason: str) -> dict[str, Any]:
    case, _, given = label.partition(": ")
    return asdict(Outcome(False, None, seen=reason)) | {
        "group": name, "case": case, "input": given, "behaviour": "ends well", "verdict": "failed"
    }  # fmt: skip
