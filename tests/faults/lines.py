"""Which tests execute which line: one run under coverage per folder of tests, kept for the runs with faults."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from tests.faults.copies import Copy
from tests.faults.sites import PACKAGES, Fault

# what can execute the packages' lines without costing more than it says; nearest to the packages first
FOLDERS = (
    *("formats", "skinning", "passes", "shaders", "tracking", "net", "scene", "mesh", "detail", "gl"),
    *("test_renderer.py", "api", "golden", "motion", "apps"),
)
SETTINGS = """\
[run]
data_file = {data}
parallel = true
include = {include}
patch = _exit
sigterm = true
context = ${{FAULTS_STARTED-}}
disable_warnings = no-data-collected,dynamic-conflict
"""
STARTED = "started by "  # the context of lines in processes of their own: the file whose test started them


def make_map(copy: Copy, folder: Path, folders: Sequence[str], limit: float) -> None:
    """Leaves NAME.lines (coverage's data) and NAME.json (tests with their seconds, and what failed) in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in folders:
        told, data = folder / f"{name}.json", folder / f"{name}.lines"
        if told.exists() or not (copy.root / "tests" / name).exists():
            continue
        settings = folder / f"{name}.ini"
        include = ",".join(f"{copy.root}/glsplat/{package}/*" for package in PACKAGES)
        settings.write_text(SETTINGS.format(data=data, include=include))
        run = copy.run(
            [f"tests/{name}"],
            limit,
            before=["-m", "coverage", "run", f"--rcfile={settings}"],
            FAULTS_LINES=str(settings),
        )
        copy.call("-m", "coverage", "combine", "-q", f"--rcfile={settings}")
        red = sorted(set(run.failed))
        told.write_text(json.dumps({"root": str(copy.root), "seconds": run.passed, "red": red}))
        print(f"map: tests/{name}, {len(run.passed)} tests, {len(red)} red, {run.seconds:.0f} s", flush=True)


class Lines:
    """The map, read."""

    def __init__(self, folder: Path) -> None:
        from coverage import CoverageData

        self.seconds: dict[str, float] = {}
        self.red: set[str] = set()
        self._data: list[tuple[str, CoverageData]] = []
        for told in sorted(folder.glob("*.json")):
            entry = json.loads(told.read_text())
            self.seconds |= entry["seconds"]
            self.red |= set(entry["red"])
            if told.with_suffix(".lines").exists():
                data = CoverageData(basename=str(told.with_suffix(".lines")))
                data.read()
                self._data.append((entry["root"], data))

    def tests(self, fault: Fault, budget: float) -> list[str]:
        """Those that execute the line; nearest folder first, files as wholes, as many as fit the seconds."""
        direct, started = self._executing(fault.file, fault.line)
        if not direct and not started and fault.statement != fault.line:
            direct, started = self._executing(fault.file, fault.statement)
        others = {t for t in self.seconds if t.split("::")[0] in started} - direct
        # what runs where a module is imported or a fixture of a file is set up is seen by the file's other tests too
        files = {t.split("::")[0] for t in direct}
        beside = {t for t in self.seconds if t.split("::")[0] in files} - direct - others
        result: list[str] = []
        spent = 0.0
        for group in (direct, others, beside):
            for test in self._nearest(group, fault.file):
                spent += self.seconds.get(test, 1.0)
                if spent < budget:
                    result.append(test)
        return result or [f"tests/{fault.package}"]

    def _executing(self, file: str, line: int) -> tuple[set[str], set[str]]:
        direct: set[str] = set()
        started: set[str] = set()
        for root, data in self._data:
            for context in data.contexts_by_lineno(f"{root}/{file}").get(line, []):
                if context.startswith(STARTED):
                    started.add(context.removeprefix(STARTED))
                elif context:
                    direct.add(context)
        return direct, started

    def _nearest(self, tests: Iterable[str], file: str) -> list[str]:
        """By how much of the path is the module's, then files that are soon done, then as they are written."""
        costs: dict[str, float] = {}
        listed = list(tests)
        for test in listed:
            costs[test.split("::")[0]] = costs.get(test.split("::")[0], 0.0) + self.seconds.get(test, 1.0)
        parts = file.removesuffix(".py").split("/")[1:]

        def rank(test: str) -> tuple[int, float, str, str]:
            name = test.split("::")[0]
            common = 0
            for mine, theirs in zip(parts, name.removesuffix(".py").split("/")[1:], strict=False):
                if mine != theirs.removeprefix("test_"):
                    break
                common += 1
            return -common, costs[name], name, test

        return sorted(listed, key=rank)
