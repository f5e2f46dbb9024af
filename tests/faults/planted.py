"""Installed as module ``planted`` in a copy's environment, where every process imports it at its start.

It imports the copy's packages, records which test reaches a probe, and is the pytest plugin of the runs. A probe in
Python is a call of ``fault_probe``; in GLSL it is a comment, reached where a program with that text runs.
PYTEST_DONT_REWRITE: it is imported before pytest is.
"""

from __future__ import annotations

import builtins
import faulthandler
import json
import os
import re
import sys
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import spec_from_file_location
from pathlib import Path
from typing import Any

SETTINGS: dict[str, Any] = json.loads(Path(__file__).with_suffix(".json").read_text())
FOLDERS: dict[str, str] = SETTINGS["folders"]  # package -> its folder in the copy
_seen: set[tuple[int, str]] = set()


def _append(path: str, *entry: object) -> None:
    with open(path, "a") as stream:
        stream.write(json.dumps(entry) + "\n")


def fault_probe(number: int) -> None:
    """Record the current test and its phase, in processes that it started too; "" is an import before any test."""
    current = os.environ.get("PYTEST_CURRENT_TEST", "")
    if (number, current) not in _seen:
        _seen.add((number, current))
        test, _, phase = current.rpartition(" (")
        _append(SETTINGS["hits"], number, test, phase.rstrip(")"))


def _watch(moderngl: Any) -> None:
    """Run the probes of a program's text whenever the program runs."""

    def compiled(method: Any) -> Any:
        def compile_(self: Any, *args: Any, **named: Any) -> Any:
            program = method(self, *args, **named)
            program.probes = set(map(int, re.findall(r"fault-probe (\d+)", f"{args}{named}")))
            return program

        return compile_

    def running(method: Any) -> Any:
        def run(self: Any, *args: Any, **named: Any) -> Any:
            for number in getattr(getattr(self, "program", self), "probes", ()):
                fault_probe(number)
            return method(self, *args, **named)

        return run

    for wrap, owner, names in (
        (compiled, moderngl.Context, ("program", "compute_shader")),
        (running, moderngl.VertexArray, ("render", "render_indirect", "transform")),
        (running, moderngl.ComputeShader, ("run", "run_indirect")),
    ):
        for name in names:
            setattr(owner, name, wrap(getattr(owner, name)))


class Finder:
    """Finds the copy's packages before any other, and watches moderngl once it is imported."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if name in FOLDERS:
            folder = FOLDERS[name]
            return spec_from_file_location(name, f"{folder}/__init__.py", submodule_search_locations=[folder])
        spec = PathFinder.find_spec(name) if name == "moderngl" else None
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                execute(module)
                _watch(module)

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


sys.meta_path.insert(0, Finder)
builtins.fault_probe = fault_probe  # type: ignore[attr-defined]


class Plugin:
    """Runs the tests of FAULTS_TESTS (id -> seconds it may take), in their order; logs to FAULTS_LOG."""

    def __init__(self, runs: bool) -> None:
        self._runs = runs  # not in xdist's controller
        self._log = os.environ["FAULTS_LOG"]
        self._tests: dict[str, float] = json.loads(Path(os.environ["FAULTS_TESTS"]).read_text())
        self._seconds: dict[str, float] = {}
        self._trace = open(self._log + ".trace", "w")

    def pytest_collection_modifyitems(self, config: Any, items: list[Any]) -> None:
        if config.option.collectonly:
            _append(self._log, "collected", [item.nodeid for item in items])
        else:
            found = {item.nodeid: item for item in items}
            items[:] = [found[test] for test in self._tests if test in found]

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            _append(self._log, "failed", report.nodeid, 0)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        if self._runs:
            _append(self._log, "started", nodeid, 0)
            faulthandler.dump_traceback_later(self._tests[nodeid], exit=True, file=self._trace)

    def pytest_runtest_logreport(self, report: Any) -> None:
        if self._runs:
            seconds = self._seconds[report.nodeid] = self._seconds.get(report.nodeid, 0) + report.duration
            if report.failed or report.when == "teardown":
                _append(self._log, "failed" if report.failed else "passed", report.nodeid, round(seconds, 3))
            if report.when == "teardown":
                faulthandler.cancel_dump_traceback_later()


def pytest_configure(config: Any) -> None:
    if "FAULTS_LOG" in os.environ:
        runs = hasattr(config, "workerinput") or not getattr(config.option, "numprocesses", None)
        config.pluginmanager.register(Plugin(runs))
