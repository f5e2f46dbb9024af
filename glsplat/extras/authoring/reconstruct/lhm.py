"""A reconstructor that runs the user's own installation of LHM: its interpreter runs one script in its folder.

glsplat contains nothing of LHM. Its weights are for non-commercial use (CC BY-NC 4.0) and need SMPL-X's files.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from glsplat.avatar import Avatar
from glsplat.errors import FormatError, GlsplatError
from glsplat.extras.authoring.importers.lhm_dump import load_lhm_dump
from glsplat.extras.authoring.networks.people import DetectedPerson

from .reconstructor import Mask, Options, Picture, Progress

_SCRIPT = "lhm_script.py"
_TAIL_BYTES = 8192  # of its output that are read
_PROGRESS_LINE = re.compile(rb"glsplat: ([01]\.\d+) ([\w ]+)")  # printed by the script
_REMOVED_VARIABLES = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__")


@dataclass(frozen=True)
class Lhm:
    """A checkout of LHM, the interpreter of its environment, and a time limit."""

    folder: Path
    python: Path
    timeout: float = 600.0  # seconds
    model: str = "LHM-500M"  # a name in the checkout's table, or a folder of weights

    def reconstruct(self, pictures: Mapping[str, Picture], masks: Mapping[str, Mask], options: Options) -> Avatar:
        """Return the avatar; see ``Reconstructor``. LHM takes the front alone and chooses height and splats itself."""
        if len(pictures) > 1 or options.height is not None:
            found = ", ".join(side for side in pictures if side != "front") or "a height"
            raise GlsplatError(f"LHM takes the front picture alone, not {found}; leave it out")
        front = pictures["front"]
        try:
            with tempfile.TemporaryDirectory(prefix="glsplat-lhm-", ignore_cleanup_errors=True) as name:
                workspace = Path(name)
                _write(workspace / "picture.png", front.rgb[..., ::-1])
                _write(workspace / "mask.png", masks["front"].astype(np.uint8) * 255)
                script = workspace / _SCRIPT  # in a folder of its own: a script can import its neighbours
                script.write_bytes(files(__package__).joinpath(_SCRIPT).read_bytes())
                dump = workspace / "dump.npz"
                box = [str(v) for v in _head_box(front.rgb.shape, front.person)]
                arguments = ["--folder", str(workspace), "--model", self.model, "--head", *box]
                self._run([str(self.python), str(script), *arguments], workspace, options.progress)
                if not dump.is_file():
                    raise GlsplatError(f"LHM ended without a result (in {self.folder})")
                try:
                    return load_lhm_dump(dump)
                except FormatError as error:
                    raise FormatError(str(error).replace(str(dump), "what LHM wrote")) from None
        except OSError as error:
            raise GlsplatError(f"LHM cannot be run: {error.strerror or error} ({error.filename or name})") from None

    def _run(self, command: list[str], workspace: Path, progress: Progress) -> None:
        """Run LHM, and kill its process group in any case. Raises GlsplatError for a failure or a timeout."""
        environment = {key: value for key, value in os.environ.items() if key not in _REMOVED_VARIABLES}
        environment |= {"TMPDIR": str(workspace), "PYTHONUNBUFFERED": "1"}
        output, errors = workspace / "output.txt", workspace / "errors.txt"
        with output.open("wb") as out, errors.open("wb") as err:
            process = subprocess.Popen(
                command,
                cwd=self.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
        deadline = time.monotonic() + self.timeout
        try:
            while True:
                try:
                    code = process.wait(0.2)
                    break
                except subprocess.TimeoutExpired:
                    steps = _PROGRESS_LINE.findall(_tail(output))
                    progress(*((steps[-1][1].decode(), float(steps[-1][0])) if steps else ("starting LHM", 0.0)))
                    if time.monotonic() > deadline:
                        raise GlsplatError(
                            f"LHM was not done after {self.timeout:g} s; set GLSPLAT_LHM_TIMEOUT to more seconds"
                        ) from None
        finally:
            _end(process)
        if code:
            how = f"exit code {code}" if code > 0 else f"signal {-code}"
            raise GlsplatError(f"LHM failed ({how}): {_last_line(errors) or _last_line(output) or 'it said nothing'}")


def from_environment() -> Lhm:
    """Return the installation of GLSPLAT_LHM, _LHM_PYTHON, _LHM_TIMEOUT and _LHM_MODEL. Raises GlsplatError."""
    configured = os.environ.get("GLSPLAT_LHM", "")
    if not configured:
        raise GlsplatError("where LHM is installed is not known; set GLSPLAT_LHM to the folder of its checkout")
    folder = Path(configured).absolute()
    if not (folder / "LHM").is_dir():
        raise GlsplatError(f"GLSPLAT_LHM: {folder} is not a checkout of LHM: it has no folder LHM")
    named = os.environ.get("GLSPLAT_LHM_PYTHON", "")
    # links are not resolved: an interpreter finds its virtual environment by the place of the link
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


def _tail(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - _TAIL_BYTES, 0))
        return file.read()


def _last_line(path: Path) -> str:
    """Return the last line that is not empty, without control characters."""
    lines = [line.strip() for line in re.split(r"[\r\n]+", _tail(path).decode("utf-8", "replace"))]
    last = next((line for line in reversed(lines) if line), "")
    return "".join(c if c.isprintable() else "?" for c in last)[:300]


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and its group."""
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


def _head_box(shape: tuple[int, ...], person: DetectedPerson | None) -> tuple[int, int, int, int]:
    """Return a square around the head, in pixels (left, top, right, bottom); zeros without a face."""
    if person is None or person.face.presence < 0.5:
        return 0, 0, 0, 0
    low, high = person.face.points[:, :2].min(axis=0), person.face.points[:, :2].max(axis=0)
    half = 0.85 * (high[1] - low[1])  # the landmarks reach from brow to chin
    x, y = (low[0] + high[0]) / 2, (low[1] + high[1]) / 2 - 0.2 * half
    left, top = max(round(x - half), 0), max(round(y - half), 0)
    return left, top, min(round(x + half), shape[1]), min(round(y + half), shape[0])
