"""The user's own installation of LHM as a reconstructor: its interpreter runs one script in its folder.

Nothing of LHM comes with glsplat. Its weights are for non-commercial use (CC BY-NC 4.0) and need SMPL-X's files.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.importers.lhm_dump import load_lhm_dump
from glsplat.extras.authoring.networks.people import DetectedPerson

from .reconstructor import Mask, Options, Picture, Progress

__all__ = ["Lhm", "from_environment"]

_SCRIPT = "lhm_script.py"
_TAIL = 8192  # bytes of what it says that are kept
_STEP = re.compile(rb"glsplat: ([01]\.\d+) ([\w ]+)")  # how the script tells how far it is
_NOT_THEIRS = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__")  # of our environment


@dataclass(frozen=True)
class Lhm:
    """A checkout of LHM, the interpreter of its environment, and how long it may take."""

    folder: Path
    python: Path
    timeout: float = 600.0  # seconds
    model: str = "LHM-500M"  # a name that the checkout knows, or a folder of weights

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """As the protocol says. LHM takes the front alone, and decides height and number of splats itself."""
        if len(pictures) > 1 or options.height is not None:
            found = ", ".join(side for side in pictures if side != "front") or "a height"
            raise GlsplatError(f"LHM takes the front picture alone, not {found}; leave it out")
        front = pictures["front"]
        try:
            with tempfile.TemporaryDirectory(prefix="glsplat-lhm-", ignore_cleanup_errors=True) as name:
                place = Path(name)
                _write(place / "picture.png", front.rgb[..., ::-1])
                _write(place / "mask.png", masks["front"].astype(np.uint8) * 255)
                script = place / _SCRIPT  # alone: what lies beside a script can be imported by it
                script.write_bytes(files(__package__).joinpath(_SCRIPT).read_bytes())
                dump = place / "dump.npz"
                box = [str(v) for v in _head(front.rgb.shape, front.person)]
                words = [str(self.python), str(script), "--folder", str(place), "--model", self.model, "--head", *box]
                self._run(words, place, options.progress)
                if not dump.is_file():
                    raise GlsplatError(f"LHM ended without a result (in {self.folder})")
                try:
                    return load_lhm_dump(dump)
                except FormatError as error:
                    raise FormatError(str(error).replace(str(dump), "what LHM wrote")) from None
        except OSError as error:
            raise GlsplatError(f"LHM cannot be run: {error.strerror or error} ({error.filename or name})") from None

    def _run(self, words: list[str], place: Path, progress: Progress) -> None:
        """Start it, wait for it, and end it with all that it started, whatever happens here."""
        environment = {key: value for key, value in os.environ.items() if key not in _NOT_THEIRS}
        environment |= {"TMPDIR": str(place), "PYTHONUNBUFFERED": "1"}
        process = subprocess.Popen(
            words,
            cwd=self.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )
        assert process.stdout is not None and process.stderr is not None
        said, wrong = _Tail(process.stdout), _Tail(process.stderr)
        until = time.monotonic() + self.timeout
        try:
            while True:
                try:
                    code = process.wait(0.2)
                    break
                except subprocess.TimeoutExpired:
                    steps = _STEP.findall(said.data)
                    progress(*((steps[-1][1].decode(), float(steps[-1][0])) if steps else ("starting LHM", 0.0)))
                    if time.monotonic() > until:
                        raise GlsplatError(
                            f"LHM was not done after {self.timeout:g} s; set GLSPLAT_LHM_TIMEOUT to more seconds"
                        ) from None
        finally:
            _end(process)
            said.close()
            wrong.close()
        if code:
            how = f"exit code {code}" if code > 0 else f"signal {-code}"
            raise GlsplatError(f"LHM failed ({how}): {wrong.line() or said.line() or 'it said nothing'}")


def from_environment() -> Lhm:
    """The installation that GLSPLAT_LHM, _LHM_PYTHON, _LHM_TIMEOUT and _LHM_MODEL describe. Raises GlsplatError."""
    told = os.environ.get("GLSPLAT_LHM", "")
    if not told:
        raise GlsplatError("where LHM is installed is not known; set GLSPLAT_LHM to the folder of its checkout")
    folder = Path(told).absolute()
    if not (folder / "LHM").is_dir():
        raise GlsplatError(f"GLSPLAT_LHM: {folder} is no checkout of LHM, it has no folder LHM")
    named = os.environ.get("GLSPLAT_LHM_PYTHON", "")
    # a link is not followed: what it stands beside makes it the interpreter of a virtual environment
    python = Path(named).absolute() if named else folder / ".venv" / "bin" / "python"
    if not os.access(python, os.X_OK) or python.is_dir():
        raise GlsplatError(f"{python}: no interpreter there; set GLSPLAT_LHM_PYTHON to the python that runs LHM")
    seconds = os.environ.get("GLSPLAT_LHM_TIMEOUT", str(Lhm.timeout))
    try:
        timeout = float(seconds)
    except ValueError:
        timeout = 0.0
    if not 0 < timeout < 1e6:
        raise GlsplatError(f"GLSPLAT_LHM_TIMEOUT needs seconds above 0, not {seconds[:40]!r}")
    return Lhm(folder, python, timeout, os.environ.get("GLSPLAT_LHM_MODEL") or Lhm.model)


class _Tail:
    """Reads a pipe to its end in a thread and keeps the last bytes, so that the writer never waits."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self.data = b""
        self._pipe = pipe
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with suppress(OSError, ValueError):  # closed from the other side
            while part := os.read(self._pipe.fileno(), 65536):
                self.data = (self.data + part)[-_TAIL:]

    def close(self) -> None:
        """Wait for what is on its way; a grandchild that escaped may keep the pipe open for ever."""
        self._thread.join(2.0)
        if not self._thread.is_alive():
            self._pipe.close()

    def line(self) -> str:
        """The last line that says something, without what a terminal would obey."""
        lines = [line.strip() for line in re.split(r"[\r\n]+", self.data.decode("utf-8", "replace"))]
        last = next((line for line in reversed(lines) if line), "")
        return "".join(c if c.isprintable() else "?" for c in last)[:300]


def _end(process: subprocess.Popen[bytes]) -> None:
    """The process and its group, which is its own."""
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def _write(path: Path, picture: NDArray[np.uint8]) -> None:
    ok, data = cv2.imencode(".png", np.ascontiguousarray(picture))
    if not ok:
        raise GlsplatError(f"{path.name}: the picture could not be encoded for LHM")
    path.write_bytes(data.tobytes())


def _head(shape: tuple[int, ...], person: DetectedPerson | None) -> tuple[int, int, int, int]:
    """A square about the head, in pixels (left, top, right, bottom); of no size where no face is seen."""
    if person is None or person.face.presence < 0.5:
        return 0, 0, 0, 0
    low, high = person.face.points[:, :2].min(axis=0), person.face.points[:, :2].max(axis=0)
    half = 0.85 * (high[1] - low[1])  # the landmarks reach from brow to chin
    x, y = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2 - 0.2 * half
    left, top = max(round(x - half), 0), max(round(y - half), 0)
    return left, top, min(round(x + half), shape[1]), min(round(y + half), shape[0])
