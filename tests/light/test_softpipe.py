"""Lit pictures once more on another rasterizer: Mesa's softpipe, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.gl
def test_the_same_holds_on_softpipe() -> None:
    env = {**os.environ, "GALLIUM_DRIVER": "softpipe"}
    driver = "import glsplat; c = glsplat.create_context(); print(c.driver); c.release()"
    found = subprocess.run(
        [sys.executable, "-c", driver], cwd=ROOT, env=env, capture_output=True, text=True, check=True
    )
    assert "softpipe" in found.stdout
    tests = "tests/light/test_lit_frames.py"
    chosen = ["-k", "test_splats_that_stand or (expression and polar) or flat"]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", tests, *chosen]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0 and "12 passed" in done.stdout, done.stdout[-3000:] + done.stderr[-1000:]
