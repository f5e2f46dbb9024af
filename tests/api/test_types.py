"""The types of the API as a user's checker sees them: a strict program is clean, and it runs."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests import needs

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "tests" / "api" / "typed_program.py"


def run(*command: str, cwd: Path = ROOT) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_a_strict_program_is_clean(tmp_path: Path) -> None:
    run(sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(PROGRAM))
    if pyright := needs.program("pyright"):  # no dependency: it is a second opinion where it is installed
        settings = {"include": [str(PROGRAM)], "typeCheckingMode": "strict", "extraPaths": [str(ROOT)]}
        (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
        found = run(pyright, "--pythonpath", sys.executable, "-p", str(tmp_path))
        assert "0 errors, 0 warnings" in found, found


def test_mypy_would_notice(tmp_path: Path) -> None:
    """The check above can fail: what is not in the types is found."""
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        PROGRAM.read_text().replace('{"source": "made here"}', '"made here"').replace("0.1 * step", "step")
    )
    with pytest.raises(AssertionError, match='incompatible type "str"; expected "Mapping'):
        run(sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(wrong))


@pytest.mark.gl
def test_the_strict_program_runs(tmp_path: Path) -> None:
    said = run(sys.executable, "-W", "error", str(PROGRAM), str(tmp_path), cwd=ROOT)
    assert "nothing.ply" in said and "'joints': 2" in said and said.rstrip().endswith("True")
