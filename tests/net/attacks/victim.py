"""``glsplat serve`` as a process of its own with default options, and what can be seen of it from outside."""

from __future__ import annotations

import contextlib
import json
import resource
import signal
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil

from tests.apps.cli import serve_words
from tests.net.attacks.sockets import Target

__all__ = ["Victim", "victim"]

ROOT = Path(__file__).resolve().parents[3]


class Victim:
    """A running server."""

    def __init__(self, process: subprocess.Popen[str], port: int, driver: str, log: Path) -> None:
        self.process, self.port, self.driver, self._log = process, port, driver, log
        self.target = Target(port)

    @property
    def log(self) -> str:
        """All that it wrote to standard error."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    @property
    def log_lines(self) -> int:
        return self.log.count("\n")

    def alive(self) -> bool:
        """The process runs and says that it is healthy."""
        return self.process.poll() is None and self.get("/healthz") == "ok\n"

    def get(self, path: str) -> str:
        """A page, or what went wrong."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.port}{path}", timeout=60) as answer:
                return str(answer.read().decode())
        except OSError as error:
            return str(error)

    def stats(self) -> dict[str, Any]:
        """/stats, or nothing where the server does not answer."""
        try:
            return dict(json.loads(self.get("/stats")))
        except ValueError:
            return {}

    def rss(self) -> dict[str, float]:
        """Resident megabytes: of the process that serves and of all together (the renderer is a process of its own)."""
        server = psutil.Process(self.process.pid)
        own = server.memory_info().rss / 1e6
        return {"server": own, "all": own + sum(p.memory_info().rss for p in server.children(recursive=True)) / 1e6}

    def stop(self) -> int:
        """SIGTERM; the exit status."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


@contextlib.contextmanager
def victim(*options: str, files: int | None = None, start: float = 90.0) -> Iterator[Victim]:
    """A server on a free port.

    Of the ``options``, ``name=value`` go into its file. ``files``: the descriptors it may have (``ulimit -n``).
    """

    def limit() -> None:
        if files is not None:
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

    command = [sys.executable, "-m", "apps.cli", "serve", "--port", "0", "--json"]
    with tempfile.TemporaryDirectory() as folder:
        command += serve_words(Path(folder), ["without-consent=true", *options])
        log = Path(folder) / "log"
        with log.open("w") as errors:
            process = subprocess.Popen(
                command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True, preexec_fn=limit
            )
        assert process.stdout is not None
        try:
            line = process.stdout.readline()
            if not line:
                raise RuntimeError(f"the server did not start: {log.read_text()[-500:]}")
            told = json.loads(line)
            server = Victim(process, told["port"], told["driver"], log)
            yield server
            server.stop()
        finally:
            for child in psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []:
                child.kill()
            process.kill()
            process.communicate()
