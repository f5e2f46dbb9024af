"""A server in a process of its own that may open 48 files."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.net.wire import HANG

__all__ = ["few_descriptors"]

ROOT = Path(__file__).parents[3]
FEW = """
import asyncio, logging, resource, sys
sys.path.insert(0, sys.argv[1])
resource.setrlimit(resource.RLIMIT_NOFILE, (48, 48))
from glsplat.net.guard.limits import Limits
from glsplat.net.server import Server, ServerConfig
from tests.net.conftest import FakeBackend
logging.basicConfig(format="LOG %(message)s")
if sys.argv[2] == "no room kept":
    import glsplat.net.guard.listener as listener
    listener._descriptors_left = lambda: None
server = Server(FakeBackend(noise=True), ServerConfig(port=0, limits=Limits(visits_burst=1e9)))
asyncio.run(server.run(lambda: print(server.port, flush=True)))
"""


@contextmanager
def few_descriptors(log: Path, how: str = "as it is") -> Iterator[int]:
    """Its port; it logs to the file, and has to end in order at the end."""
    command = [sys.executable, "-c", FEW, str(ROOT), how]
    with log.open("wb") as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
    try:
        assert process.stdout is not None
        yield int(process.stdout.readline())
        process.send_signal(signal.SIGTERM)
        assert process.wait(HANG) == 0
    finally:
        process.kill()
        process.communicate()
