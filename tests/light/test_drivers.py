"""Lit pictures once more on other drivers, each in a process of its own: Mesa's softpipe, and zink on lavapipe."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.golden.test_drivers import ROOT, environment_of

TESTS = "tests/light/test_lit_frames.py"


@pytest.mark.check
@pytest.mark.gl
@pytest.mark.parametrize(
    ("driver", "chosen", "passes"),
    [("softpipe", "flat", 4), ("zink", "expression and polar", 2)],
)
def test_the_same_holds(driver: str, chosen: str, passes: int) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", TESTS, "-k", chosen]
    env = environment_of(driver)
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0 and f"{passes} passed" in done.stdout, done.stdout[-3000:] + done.stderr[-1000:]
