"""Plants faults by seed in a copy of the tree, one at a time, and tells which test finds each.

python -m tests.faults --seed 1 --count 10 --only net

The kinds are a sign, a bound (< to <=), an off-by-one, two arguments swapped, a lock dropped (in GLSL a barrier) and a
check dropped. A fault in Python is tried with the tests that execute its line, nearest folder first; which they are
comes from a run of the suite under coverage (once; `pip install coverage`), kept in the folder of --keep with all
results, so that a run that was stopped goes on where it was. A test that fails is run without the fault too: where it
fails there as well, it does not count.

Another tree, with the environment that runs this; the same faults in a later tree, the test that found each first:

/elsewhere/.venv/bin/python -m tests.faults --tree /elsewhere --keep /tmp/faults
python -m tests.faults --again /tmp/faults/faults-1.json --keep /tmp/later
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence, Set
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tests.faults.copies import Copy, Run
from tests.faults.lines import FOLDERS, Lines, make_map
from tests.faults.sites import PACKAGES, Fault, drawn

ROOT = Path(__file__).resolve().parents[2]
SHADERS = ("shaders", "passes", "skinning", "golden", "gl", "scene", "detail", "mesh", "test_renderer.py")


@dataclass
class Result:
    """What came of one fault."""

    fault: Fault
    state: str = "missed"  # found, missed, limit (missed, and not all tests were tried), gone (no such line)
    by: str = ""
    seconds: float = 0.0
    tests: list[str] = field(default_factory=list)  # to try, in this order

    def line(self) -> str:
        f = self.fault
        by = f"found by {self.by}" if self.state == "found" else self.state.upper()
        return f"{f.package} {f.kind} {f.file}:{f.line}: {f.before}  ->  {f.after}  [{by}, {self.seconds:.0f} s]"


class Trial:
    """Tries faults in one copy."""

    def __init__(self, copy: Copy, limit: float, red: set[str]) -> None:
        self._copy, self._limit, self._red = copy, limit, red

    def try_fault(self, result: Result) -> None:
        passed: set[str] = set()
        start = time.monotonic()
        while untried := [t for t in result.tests if t not in passed and t not in self._red]:
            if not self._copy.plant(result.fault):
                result.state = "gone"
                return
            left_out = [f"--deselect={t}" for t in sorted(self._red | passed)]
            words = list(dict.fromkeys(map(_argument, untried)))
            run = self._copy.run(["-x", *left_out, *words], self._limit - (time.monotonic() - start))
            result.seconds = time.monotonic() - start
            self._copy.restore()
            passed |= set(run.passed)
            first = _first(run)
            if "::" not in first and run.code == 4:  # no such test, or a conftest that cannot be imported
                if self._copy.run(["--collect-only", *words], self._limit).code == 4:
                    raise SystemExit(f"not all of these tests are there: {' '.join(words)}")
            if first and not self._fails_anyway(first):
                result.state, result.by = "found", first
                return
            if not first:
                result.state = "limit" if run.code is None else "missed"
                return
            print(f"fails without a fault: {first}", flush=True)
            self._red.add(first)

    def _fails_anyway(self, test: str) -> bool:
        """Only of single tests: where pytest itself ended, or a file cannot be imported, it is the fault."""
        return "::" in test and bool(_first(self._copy.run([test], self._limit)))


def _argument(test: str) -> str:
    """A name made of bytes may be another one each time: all that the function is called with then."""
    return test.partition("[")[0] if "\\" in test else test


def _first(run: Run) -> str:
    if run.failed:
        return run.failed[0]
    return "" if run.code in (None, 0, 5) else f"exit {run.code} of pytest"


def _known(result: Result, there: Sequence[str], mapped: Set[str]) -> list[str]:
    """The tests of an earlier run that this tree has: by name where they moved, and what stands in their files now.

    For a fault that they did not find also what was written since (``mapped`` are the names that were there) and what
    is called after the module; that first.
    """
    by_name: dict[str, list[str]] = {}
    for test in there:
        by_name.setdefault(test.split("::")[-1], []).append(test)
    wanted = [result.by, *result.tests] if "::" in result.by else result.tests
    kept: dict[str, None] = {}
    present = set(there)
    folder = f"tests/{result.fault.package}/"
    if result.state != "found":
        own = f"/test_{Path(result.fault.file).stem}.py"
        tried = {test.split("::")[0] for test in result.tests}
        near = (t for t in there if mapped and (t.startswith(folder) or t.split("::")[0] in tried))
        since = (t for t in near if t.split("::")[-1] not in mapped)
        kept |= dict.fromkeys([*(t for t in there if t.split("::")[0].endswith(own)), *since])
    for test in wanted:
        moved = by_name.get(test.split("::")[-1], [])
        if test in present or ("::" not in test and any(t.startswith(test) for t in there)):
            kept[test] = None
        elif len(moved) == 1:
            kept[moved[0]] = None
    files = {test.split("::")[0] for test in kept if "::" in test and test.startswith(folder)}
    kept |= {test: None for test in there if test.split("::")[0] in files}
    return list(kept) or [f"tests/{result.fault.package}"]


def _table(results: Sequence[Result]) -> str:
    rows = ["package    faults  found  missed  at the limit  gone"]
    for name in (*PACKAGES, "all"):
        of = [r.state for r in results if name in (r.fault.package, "all")]
        if of:
            counts = f"{of.count('found'):7}{of.count('missed'):8}{of.count('limit'):14}{of.count('gone'):6}"
            rows.append(f"{name:9}{len(of):8}{counts}")
    return "\n".join(rows)


def _load(path: Path) -> list[Result]:
    return [Result(**{**entry, "fault": Fault(**entry["fault"])}) for entry in json.loads(path.read_text())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=10, help="faults of each package")
    parser.add_argument("--only", nargs="+", choices=PACKAGES, default=PACKAGES, help="packages")
    parser.add_argument("--tree", type=Path, default=ROOT, help="repository whose copy is changed")
    parser.add_argument("--ref", default="HEAD", help="its commit")
    parser.add_argument("--keep", type=Path, default=ROOT / "out" / "faults", help="folder of the copy and the results")
    parser.add_argument("--limit", type=float, default=150.0, help="seconds for the tests of one fault")
    parser.add_argument("--again", type=Path, help="results of another tree: plant the same faults")
    parser.add_argument(
        "--map-only", nargs="*", choices=FOLDERS, help="make the map of these folders of tests, no more"
    )
    parser.add_argument("--list", action="store_true", help="show the faults and plant none")
    options = parser.parse_args()
    if options.list:
        for name in options.only:
            for fault in drawn(options.tree, name, options.seed, options.count):
                print(Result(fault, state="listed").line())
        return
    keep = options.keep.resolve()
    copy = Copy(options.tree.resolve(), options.ref, keep / "copy")
    if options.map_only is not None:
        make_map(copy, keep / "map", options.map_only or FOLDERS, 3600.0)
        return
    known = keep / f"faults-{options.seed}.json"
    done = {r.fault.name: r for r in (_load(known) if known.exists() else [])}
    red: set[str] = set()
    todo: list[Result] = []
    if options.again:
        todo = [r for r in _load(options.again) if r.fault.package in options.only]
        there = copy.run(["--collect-only", "tests"], 600.0, FAULTS_COLLECT="1").collected
        maps = (options.again.parent / "map").glob("*.json")
        mapped = {test.split("::")[-1] for path in maps for test in json.loads(path.read_text())["seconds"]}
        todo = [Result(r.fault, tests=_known(r, there, mapped)) for r in todo]
    else:
        faults = [f for p in options.only for f in drawn(copy.root, p, options.seed, options.count)]
        if any(f.package != "shaders" for f in faults):
            make_map(copy, keep / "map", FOLDERS, 3600.0)
        lines = Lines(keep / "map")
        red |= lines.red
        shaders = [f"tests/{name}" for name in SHADERS if (copy.root / "tests" / name).exists()]
        for f in faults:
            todo.append(Result(f, tests=shaders if f.package == "shaders" else lines.tests(f, options.limit)))
    trial = Trial(copy, options.limit, red)
    for result in todo:
        if result.fault.name not in done:
            trial.try_fault(result)
            done[result.fault.name] = result
            known.write_text(json.dumps([asdict(r) for r in done.values()], indent=1))
        print(done[result.fault.name].line(), flush=True)
    print(_table([done[r.fault.name] for r in todo]))


if __name__ == "__main__":
    main()
