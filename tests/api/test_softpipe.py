"""The same on Mesa's other rasterizer, which ends at OpenGL 3.3: neither compute shaders nor clip control.

Frames of one renderer that follow each other with other cameras differ there by what came before, broken off or not:
so the tests of interrupted frames and of a user's own drawing are llvmpipe's alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.gl, pytest.mark.check]

CHOSEN = "(pair_of_kinds and own) or every_call or (test_pictures_and_state and everything)"


@pytest.mark.skipif(os.environ.get("GALLIUM_DRIVER") == "softpipe", reason="this is softpipe")
def test_contexts_and_state() -> None:
    files = [str(Path(__file__).parent / f"test_{name}.py") for name in ("contexts", "state")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", CHOSEN, *files]
    environment = os.environ | {"GALLIUM_DRIVER": "softpipe"}
    root = Path(__file__).parents[2]
    done = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout[-4000:]
