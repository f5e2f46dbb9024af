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
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.sites import Fault

HERE = Path(__file__).parent
INSTALL = """\
import sys
from importlib.machinery import PathFinder
from importlib.util import spec_from_file_location

FOLDERS = {folders!r}


class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name in FOLDERS:
            folder = FOLDERS[name]
            return spec_from_file_location(name, folder + "/__init__.py", submodule_search_locations=[folder])


sys.meta_path.insert(0, Finder)
"""


@dataclass
class Run:
    """What came of one call of pytest."""

    failed: list[str] = field(default_factory=list)  # node ids; a file's, where collecting it failed
    passed: dict[str, float] = field(default_factory=dict)  # node id -> seconds
    collected: list[str] = field(default_factory=list)
    code: int | None = None  # None: it ran out of time
    seconds: float = 0.0


class Copy:
    """Clone of a tree beside a link to its reference data. Its interpreter imports the clone, in whatever process."""

    def __init__(self, tree: Path, ref: str, folder: Path) -> None:
        self.root = folder / "tree"
        self._folder = folder
        self._clock = 0
        if self.root.exists():
            shutil.rmtree(self.root)
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run(["git", "clone", "--quiet", "--shared", "--no-checkout", tree, self.root], check=True)
        subprocess.run(["git", "checkout", "--quiet", "--detach", ref], cwd=self.root, check=True)
        shared = folder / "shared"
        if not shared.is_symlink() and (tree.parent / "shared").is_dir():
            shared.symlink_to((tree.parent / "shared").resolve())
        if not (self.root / "tests" / "faults").is_dir():  # a tree from before this script
            shutil.copytree(HERE, self.root / "tests" / "faults")
        self.python = self._environment(folder / "venv")

    def _environment(self, folder: Path) -> Path:
        """A virtual environment with the packages of ours, but not its editable install: -I and env= make no hole."""
        shutil.rmtree(folder, ignore_errors=True)
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
        paths = {"base": str(folder), "platbase": str(folder)}
        site = Path(sysconfig.get_path("purelib", "venv", vars=paths))
        ours = sysconfig.get_path("purelib")
        folders = {"glsplat": str(self.root / "glsplat"), "glsplat_apps": str(self.root / "apps")}
        (site / "the_copy.py").write_text(INSTALL.format(folders=folders))
        started = "import os; os.getenv('COVERAGE_PROCESS_START') and __import__('coverage').process_startup()"
        (site / "the_copy.pth").write_text(f"{ours}\nimport the_copy\n{started}\n")
        for script in Path(sys.executable).parent.iterdir():
            if script.is_file() and script.read_bytes()[:2] == b"#!" and not (folder / "bin" / script.name).exists():
                lines = script.read_text().split("\n", 1)
                target = folder / "bin" / script.name
                target.write_text(f"#!{folder}/bin/python\n{lines[1]}")
                target.chmod(0o755)
        python = folder / "bin" / "python"
        shown = "import glsplat, glsplat_apps as a; print(glsplat.__file__, a.__file__)"
        found = subprocess.check_output([python, "-c", shown], cwd="/", text=True, stderr=subprocess.PIPE).split()
        if found != [f"{folder}/__init__.py" for folder in folders.values()]:
            raise SystemExit(f"tests would import {found}, not the copy")
        return python

    def plant(self, fault: Fault) -> int:
        """The number of the line that was changed; 0 where the tree has no such line."""
        path = self._place(fault)
        lines = path.read_text().splitlines(keepends=True) if path else []
        alike = [i for i, line in enumerate(lines) if line.strip() == fault.before]
        if path is None or len(alike) <= fault.occurrence:
            return 0
        at = alike[fault.occurrence]
        lines[at] = lines[at].replace(fault.before, fault.after)
        self._write(path, "".join(lines))
        return at + 1

    def _place(self, fault: Fault) -> Path | None:
        """Its file; where that has the line no longer, the one file of the package that has it."""
        path = self.root / fault.file
        if path.exists() and fault.before in map(str.strip, path.read_text().splitlines()):
            return path
        others = (self.root / "glsplat" / fault.package).rglob(f"*{path.suffix}")
        having = [p for p in others if fault.before in map(str.strip, p.read_text().splitlines())]
        return having[0] if len(having) == 1 else None

    def restore(self) -> None:
        changed = subprocess.check_output(["git", "diff", "--name-only"], cwd=self.root, text=True).split()
        for name in changed:
            text = subprocess.check_output(["git", "show", f"HEAD:{name}"], cwd=self.root, text=True)
            self._write(self.root / name, text)

    def _write(self, path: Path, text: str) -> None:
        """With a time of its own: compiled modules are told apart by whole seconds and size."""
        path.write_text(text)
        self._clock += 2
        now = int(time.time()) + self._clock
        os.utime(path, (now, now))

    def call(self, *words: str) -> None:
        subprocess.run([self.python, *words], cwd=self.root, check=False, stdout=subprocess.DEVNULL)

    def run(self, words: Sequence[str], limit: float, before: Sequence[str] = (), **variables: str) -> Run:
        """Pytest with these arguments; everything that it started is gone afterwards."""
        log, arguments = self._folder / "run.jsonl", self._folder / "arguments.txt"
        log.unlink(missing_ok=True)
        arguments.write_text("".join(f"{word}\n" for word in words))
        options = ["-q", "-p", "no:cacheprovider", "-p", "tests.faults.recorder", "--timeout", "120", f"@{arguments}"]
        command = [str(self.python), *before, "-m", "pytest", *options]
        start = time.monotonic()
        with (self._folder / "output.txt").open("w") as output:
            process = subprocess.Popen(
                command,
                cwd=self.root,
                env={**os.environ, "PYTHONPATH": "", "FAULTS_LOG": str(log), **variables},
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
        run = Run(code=code, seconds=time.monotonic() - start)
        for line in log.read_text().splitlines() if log.exists() else []:
            entry = json.loads(line)
            run.failed += [entry["failed"]] if "failed" in entry else []
            run.collected += entry.get("collected", [])
            if "passed" in entry:
                run.passed[entry["passed"]] = entry["seconds"]
        return run


def _end(process: subprocess.Popen[bytes]) -> None:
    """The session's processes, by their group: Xvfb and servers that the tests started are in it."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        time.sleep(0.3)
    process.wait()
