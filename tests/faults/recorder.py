"""Plugin of the runs: writes a line per test to the file that FAULTS_LOG names, and tells coverage which test it is."""

from __future__ import annotations

import json
import os
from collections.abc import Generator
from pathlib import Path

import pytest

LOG = Path(os.environ["FAULTS_LOG"])
_seconds: dict[str, float] = {}


def _write(**entry: object) -> None:
    with LOG.open("a") as stream:
        stream.write(json.dumps(entry) + "\n")


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, None, None]:
    if "FAULTS_LINES" in os.environ:
        import coverage  # only where lines are mapped: it is no dependency of the project

        # processes that the test starts are on their own: they know the file
        os.environ["COVERAGE_PROCESS_START"] = os.environ["FAULTS_LINES"]
        os.environ["FAULTS_STARTED"] = f"started by {item.nodeid.split('::')[0]}"
        if (running := coverage.Coverage.current()) is not None:
            running.switch_context(item.nodeid)
    yield


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration
    if report.failed:
        _write(failed=report.nodeid)
    elif report.when == "teardown":
        _write(passed=report.nodeid, seconds=round(_seconds[report.nodeid], 3))


def pytest_collectreport(report: pytest.CollectReport) -> None:
    if report.failed:
        _write(failed=report.nodeid)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if "FAULTS_COLLECT" in os.environ:
        _write(collected=[item.nodeid for item in items])
