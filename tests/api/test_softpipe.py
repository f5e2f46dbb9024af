"""The same on Mesa's other rasterizer, which ends at OpenGL 3.3: neither compute shaders nor clip control."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.gl, pytest.mark.slow]

CHOSEN = (
    "(pair_of_kinds and own) or every_call or (test_pictures_and_state and everything) or sixty or signal or any_line"
)


@pytest.mark.skipif(os.environ.get("GALLIUM_DRIVER") == "softpipe", reason="this is softpipe")
def test_contexts_state_and_interrupts() -> None:
    files = [str(Path(__file__).parent / f"test_{name}.py") for name in ("contexts", "state", "interrupts")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", CHOSEN, *files]
    environment = os.environ | {"GALLIUM_DRIVER": "softpipe", "GLSPLAT_INTERRUPTS": "32"}
    root = Path(__file__).parents[2]
    done = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-4000:]
