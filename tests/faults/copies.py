"""A copy of a tree with an environment of its own, in which faults are planted and tests run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.probes import with_probes
from tests.faults.sites import Fault


@dataclass
class Run:
    """Results of one call of pytest, read from its log."""

    passed: dict[str, float] = field(default_factory=dict)  # node id -> seconds
    failed: list[str] = field(default_factory=list)  # a file's id where collecting it failed; ended or hung ones last
    collected: list[str] = field(default_factory=list)
    code: int | None = None  # None: out of time

    @classmethod
    def read(cls, log: Path, code: int | None = 0) -> Run:
        run = cls(code=code)
        started: list[str] = []
        for kind, *entry in map(json.loads, log.read_text().splitlines() if log.exists() else []):
            if kind == "passed":
                run.passed[entry[0]] = entry[1]
            elif kind == "collected":
                run.collected = entry[0]
            else:
                (run.failed if kind == "failed" else started).append(entry[0])
        run.failed += [test for test in started if test not in run.passed and test not in run.failed]
        for test in run.failed:
            run.passed.pop(test, None)
        return run


class Copy:
    """Clone of a tree beside a link to its reference data. Its interpreter imports the clone, in whatever process."""

    def __init__(self, tree: Path, ref: str, folder: Path, hits: Path) -> None:
        self.root = folder / "tree"
        self._folder, self._hits = folder, hits
        self._clock = 0
        self._originals: dict[Path, str] = {}
        shutil.rmtree(self.root, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["git", "clone", "--quiet", "--shared", "--no-checkout", tree, self.root], check=True)
        subprocess.run(["git", "checkout", "--quiet", "--detach", ref], cwd=self.root, check=True)
        shared = folder / "shared"
        if not shared.is_symlink() and (tree.parent / "shared").is_dir():
            shared.symlink_to((tree.parent / "shared").resolve())
        self._python = self._environment(folder / "venv")

    def _environment(self, folder: Path) -> Path:
        """A virtual environment with the packages of ours, but not its editable install: -I and env= make no hole."""
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
        paths = {"base": str(folder), "platbase": str(folder)}
        site, ours = Path(sysconfig.get_path("purelib", "venv", vars=paths)), Path(sysconfig.get_path("purelib"))
        folders = {"glsplat": str(self.root / "glsplat"), "glsplat_apps": str(self.root / "apps")}
        shutil.copy(Path(__file__).with_name("planted.py"), site)
        (site / "planted.json").write_text(json.dumps({"folders": folders, "hits": str(self._hits)}))
        others = [line for path in ours.glob("*.pth") for line in path.read_text().splitlines() if line.startswith("/")]
        (site / "planted.pth").write_text("\n".join([str(ours), *others, "import planted", ""]))
        for script in Path(sys.executable).parent.iterdir():
            if script.is_file() and script.read_bytes()[:2] == b"#!" and not (folder / "bin" / script.name).exists():
                target = folder / "bin" / script.name
                lines = script.read_text().split("\n", 1)
                target.write_text(f"#!{folder}/bin/python\n{lines[1]}")
                target.chmod(0o755)
        python = folder / "bin" / "python"
        shown = "import glsplat, glsplat_apps as a; print(glsplat.__file__, a.__file__)"
        found = subprocess.check_output([python, "-c", shown], cwd="/", text=True, stderr=subprocess.PIPE).split()
        if found != [f"{folder}/__init__.py" for folder in folders.values()]:
            raise SystemExit(f"tests would import {found}, not the copy")
        return python

    def plant(self, fault: Fault) -> bool:
        """Plant the fault; False where the tree has no such line."""
        if not (place := self._place(fault)):
            return False
        path, at = place
        lines = path.read_text().splitlines(keepends=True)
        lines[at] = lines[at].replace(fault.before, fault.after)
        self._write(path, "".join(lines))
        return True

    def probe(self, faults: Sequence[Fault]) -> None:
        """Plant a probe for each fault, with its number in the sequence."""
        marks: dict[Path, list[tuple[int, int, str, str]]] = defaultdict(list)
        for number, fault in enumerate(faults):
            if place := self._place(fault):
                marks[place[0]].append((number, place[1] + 1, fault.before, fault.after))
        for path, of in marks.items():
            text = path.read_text()
            if path.suffix == ".py":
                self._write(path, with_probes(text, of))
            else:
                lines = text.splitlines()
                for number, line, _, _ in of:
                    lines[line - 1] += f"  // fault-probe {number}"
                self._write(path, "\n".join(lines) + "\n")

    def _place(self, fault: Fault) -> tuple[Path, int] | None:
        """Its file and line from 0; where the file has the line no longer, the one file that has it."""
        alike: dict[Path, list[int]] = {}
        for path in (self.root / "glsplat").rglob(f"*{Path(fault.file).suffix}"):
            lines = path.read_text().splitlines()
            if found := [i for i, line in enumerate(lines) if line.strip() == fault.before]:
                alike[path] = found
        path = self.root / fault.file
        if path not in alike and len(alike) == 1:
            path = next(iter(alike))
        numbers = alike.get(path, [])
        return (path, numbers[fault.occurrence]) if len(numbers) > fault.occurrence else None

    def restore(self) -> None:
        """Write every changed file as it was."""
        for path, text in list(self._originals.items()):
            self._write(path, text)
        self._originals.clear()

    def _write(self, path: Path, text: str) -> None:
        """With a time of its own: compiled modules are told apart by whole seconds and size."""
        self._originals.setdefault(path, path.read_text())
        path.write_text(text)
        self._clock += 2
        now = int(time.time()) + self._clock
        os.utime(path, (now, now))

    def collect(self, paths: Sequence[str], select: str = "") -> list[str]:
        """Node ids of the tests at ``paths`` that the marker expression selects, in pytest's order."""
        run = self.run([*paths, "--collect-only", *(["-m", select] if select else [])], {}, 600.0)
        if run.code not in (0, 5):
            raise SystemExit(f"pytest cannot collect {' '.join(paths)}: {self._folder}/output.txt")
        return run.collected

    def run(self, words: Sequence[str], tests: Mapping[str, float], limit: float, log: Path | None = None) -> Run:
        """Run pytest with ``tests`` (id -> seconds until it counts as hung); what it started is ended afterwards."""
        if log is None:
            log = self._folder / "run.jsonl"
            log.unlink(missing_ok=True)
        chosen = self._folder / "tests.json"
        chosen.write_text(json.dumps(dict(tests)))
        files = dict.fromkeys(test.split("::")[0] for test in tests)
        command = [str(self._python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "planted", *words, *files]
        with (self._folder / "output.txt").open("w") as output:
            process = subprocess.Popen(
                command,
                cwd=self.root,
                env={**os.environ, "PYTHONPATH": "", "FAULTS_LOG": str(log), "FAULTS_TESTS": str(chosen)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            try:
                code: int | None = process.wait(limit)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                _end(process)
        return Run.read(log, code)


def _end(process: subprocess.Popen[bytes]) -> None:
    """The session's processes, by their group: Xvfb and servers that the tests started are in it."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        time.sleep(0.3)
    process.wait()
