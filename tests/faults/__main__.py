"""Plants faults by seed in copies of the tree, one at a time, and prints which test finds each.

python -m tests.faults                              # 20 faults in each package, the whole suite
python -m tests.faults --select "not check"         # the same faults, the tests of `make test`
python -m tests.faults --tree ../later --keep /tmp/later --again out/faults/faults-1.json

The kinds are a sign, a bound (< to <=), an off-by-one, two arguments swapped, a lock dropped (in GLSL a barrier) and a
check dropped. First the suite runs once with a probe at every fault's place: that tells which tests execute it (in
GLSL: run a program with the line). Then each fault is tried with these tests, nearest folder first. A test that fails
has to pass without the fault. The folder of --keep holds the map and all results: a run that was stopped goes on where
it was, a second one with other tests (--select, --tests) tries what is new, and --again plants the same faults in a
later tree, where lines may have moved. The page's own code and what it draws by WebGL are not mapped.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from itertools import chain
from pathlib import Path
from queue import SimpleQueue

from tests.faults.copies import Copy, Run
from tests.faults.sites import PACKAGES, Fault, drawn

ROOT = Path(__file__).resolve().parents[2]
STATES = ("found", "missed", "limit", "known", "gone")  # limit: missed, and not all tests were tried
FIRST_S, MORE = 10.0, 5  # seconds of tests in the first pytest of a fault; each further one has that many times more


@dataclass
class Result:
    """What is known of one fault."""

    fault: Fault
    by: list[str] = field(default_factory=list)  # tests that find it
    passed: list[str] = field(default_factory=list)  # tests that do not
    gone: bool = False
    seconds: float = 0.0


class Map:
    """Which tests execute which fault's place, and how long they take."""

    def __init__(self, folder: Path) -> None:
        self.hits_file, self._log = folder / "hits.jsonl", folder / "map.jsonl"

    def make(self, copy: Copy, faults: Sequence[Fault], tests: Iterable[str], jobs: int) -> None:
        """Run those of the tests that are not in the map yet, with a probe for each fault."""
        self._read()
        if todo := dict.fromkeys((t for t in tests if t not in self.seconds and t not in self.red), 600.0):
            print(f"map: {len(todo)} tests", flush=True)
            copy.probe(faults)
            start = time.monotonic()
            copy.run(["-n", str(jobs), "--dist", "worksteal"], todo, 4 * 3600.0, self._log)
            copy.restore()
            self._read()
            print(f"map: {time.monotonic() - start:.0f} s; failed: {' '.join(self.red) or 'none'}", flush=True)

    def _read(self) -> None:
        run = Run.read(self._log)
        self.seconds, self.red = run.passed, set(run.failed)
        self._hits: dict[int, set[str]] = defaultdict(set)
        self._set_up: dict[int, set[str]] = defaultdict(set)  # files whose fixtures execute the place
        for line in self.hits_file.read_text().splitlines() if self.hits_file.exists() else []:
            number, test, phase = json.loads(line)
            self._hits[number].add(test)
            if phase == "setup":
                self._set_up[number].add(test.split("::")[0])

    def tests(self, number: int, fault: Fault) -> tuple[list[str], list[str]]:
        """Tests that execute the place, and those that may see what it did; those nearest to the module first.

        The second are the package's where it runs at import, and the others of a file whose fixtures execute it.
        """
        hits = self._hits[number]
        folder = f"tests/{fault.package}/" if "" in hits else "::"
        beside = (t for t in self.seconds if t.split("::")[0] in self._set_up[number] or t.startswith(folder))
        return self._nearest(self.seconds.keys() & hits, fault.file), self._nearest(set(beside) - hits, fault.file)

    def _nearest(self, tests: Iterable[str], file: str) -> list[str]:
        """By how much of the path is the module's, then by the seconds of their files."""
        costs: dict[str, float] = defaultdict(float)
        listed = sorted(tests)
        for test in listed:
            costs[test.split("::")[0]] += self.seconds[test]
        own = file.partition(".")[0].split("/")[1:]

        def rank(test: str) -> tuple[int, float, str, float]:
            name = test.split("::")[0]
            theirs = name.removesuffix(".py").replace("/test_", "/").split("/")[1:]
            common = sum(mine == other for mine, other in zip(own, theirs, strict=False))
            return -common, costs[name], name, self.seconds[test]

        return sorted(listed, key=rank)


class Trial:
    """Tries faults in several copies at once; keeps the results in a file."""

    def __init__(self, copies: Sequence[Copy], map_: Map, results: list[Result], file: Path) -> None:
        self._copies: SimpleQueue[Copy] = SimpleQueue()
        for copy in copies:
            self._copies.put(copy)
        self._map, self._results, self._file = map_, results, file
        self._saving = threading.Lock()

    def try_fault(self, number: int, selected: set[str], limit: float) -> str:
        """Return what came of it. Tests that were tried before are not run again."""
        result = self._results[number]
        direct, beside = ([t for t in tests if t in selected] for tests in self._map.tests(number, result.fault))
        todo, spent = [], 0.0
        for test in [*direct, *beside]:
            spent += self._map.seconds[test]
            if spent < limit and test not in result.passed:
                todo.append(test)
        known = _is_known(result.fault)
        if not known and not selected.intersection(result.by):
            copy, start = self._copies.get(), time.monotonic()
            self._try(copy, result, todo)
            copy.restore()
            self._copies.put(copy)
            result.seconds += time.monotonic() - start
            with self._saving:
                self._file.write_text(json.dumps([asdict(r) for r in self._results], indent=1))
        state = "missed" if {*result.passed, *self._map.red} >= set(direct) else "limit"
        if found := selected.intersection(result.by):
            state = "found"
        elif result.gone or known:
            state = "gone" if result.gone else "known"
        f, by = result.fault, f" by {min(found)}" if found else ""
        outcome = f"{state}{by}, {len(direct)} tests, {result.seconds:.0f} s"
        print(f"{f.package} {f.kind} {f.file}:{f.line}: {f.before}  ->  {f.after}  [{outcome}]", flush=True)
        return state

    def _try(self, copy: Copy, result: Result, todo: list[str]) -> None:
        budget = FIRST_S
        result.gone = not copy.plant(result.fault)
        while not result.gone and (todo := [t for t in todo if t not in result.passed and t not in self._map.red]):
            now: list[str] = []
            spent = 0.0
            while len(now) < len(todo) and (not now or spent < budget):
                now.append(todo[len(now)])
                spent += self._map.seconds[now[-1]]
            budget *= MORE
            run = self._run(copy, now)
            result.passed += run.passed
            if not run.failed and run.code in (0, 5):
                todo = todo[len(now) :]
                continue
            # a file that cannot be imported, or a conftest, counts for the first of its tests
            failed = run.failed[0] if run.failed else now[0]
            first = next((t for t in now if t.startswith(failed)), now[0])
            copy.restore()
            if first in self._run(copy, [first]).passed:
                result.by.append(first)
                return
            print(f"fails without a fault: {first}", flush=True)
            self._map.red.add(first)
            copy.plant(result.fault)

    def _run(self, copy: Copy, tests: Sequence[str]) -> Run:
        bounds = {test: 30.0 + 10.0 * self._map.seconds[test] for test in tests}
        return copy.run(["-x"], bounds, 120.0 + sum(bounds.values()))


def _is_known(fault: Fault) -> bool:
    """Whether known.toml has the reason why no test can find it."""
    known = tomllib.loads(Path(__file__).with_name("known.toml").read_text())["fault"]
    place = Path(fault.file).name, fault.before, fault.after, fault.occurrence
    return any((Path(k["file"]).name, k["before"], k["after"], k.get("occurrence", 0)) == place for k in known)


def _table(states: dict[str, list[str]]) -> str:
    """``states`` of each package's faults as rows of counts."""
    rows = [f"{'package':9}{'faults':>8}" + "".join(f"{state:>12}" for state in STATES)]
    for name, of in {**states, "all": list(chain(*states.values()))}.items():
        rows.append(f"{name:9}{len(of):8}" + "".join(f"{of.count(state):12}" for state in STATES))
    return "\n".join(rows)


def _load(path: Path) -> list[Result]:
    return [Result(**{**entry, "fault": Fault(**entry["fault"])}) for entry in json.loads(path.read_text())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20, help="faults of each package")
    parser.add_argument("--only", nargs="+", choices=PACKAGES, default=PACKAGES, help="packages to try, in this order")
    parser.add_argument("--tree", type=Path, default=ROOT, help="repository whose copies are changed")
    parser.add_argument("--ref", default="HEAD", help="its commit")
    parser.add_argument("--keep", type=Path, default=ROOT / "out" / "faults", help="folder of copies, map and results")
    parser.add_argument("--jobs", type=int, default=4, help="copies, each with one pytest at a time")
    parser.add_argument("--tests", nargs="+", default=["tests"], help="paths whose tests are tried")
    parser.add_argument("--select", default="", help="marker expression of the tests that are tried")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds of tests for one fault")
    parser.add_argument("--again", type=Path, help="results of another tree: plant the same faults")
    options = parser.parse_args()
    keep, tree = options.keep.resolve(), options.tree.resolve()
    map_ = Map(keep)
    copies = [Copy(tree, options.ref, keep / f"copy-{n}", map_.hits_file) for n in range(options.jobs)]
    faults = [f for p in PACKAGES for f in drawn(copies[0].root, p, options.seed, options.count)]
    if options.again:
        faults = [result.fault for result in _load(options.again)]
    file = keep / f"faults-{options.seed}.json"
    results = _load(file) if file.exists() else [Result(fault) for fault in faults]
    if [r.fault for r in results] != faults:
        raise SystemExit(f"{file} has other faults: give another folder by --keep")
    selected = copies[0].collect(options.tests, options.select)
    map_.make(copies[0], faults, selected, options.jobs)
    trial = Trial(copies, map_, results, file)
    states: dict[str, list[str]] = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for name in options.only:
            numbers = [n for n, fault in enumerate(faults) if fault.package == name]
            states[name] = list(pool.map(lambda n: trial.try_fault(n, set(selected), options.limit), numbers))
    print(_table(states))


if __name__ == "__main__":
    main()
