"""The contract images on the other drivers that need no GPU, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

DRIVERS = {
    "softpipe": {"GALLIUM_DRIVER": "softpipe"},  # OpenGL 3.3 only
    "osmesa": {"GLSPLAT_BACKEND": "osmesa"},
    "zink": {"GALLIUM_DRIVER": "zink", "LIBGL_ALWAYS_SOFTWARE": "1"},  # on Vulkan's lavapipe
}
NAMES = {"softpipe": "softpipe", "osmesa": "llvmpipe", "zink": "zink"}
SCENES = "32f and (demosthenes_10k_stereo or playbot_lod3 or depth_ties)"
"""A pair of a real capture, a game's character, and equal depths: three that tell drivers apart and are quick."""


@pytest.mark.gl
@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS)
def test_contract_images(driver: str, shared_data: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GALLIUM", "GLSPLAT"))} | DRIVERS[driver]
    asked = "import glsplat; c = glsplat.create_context(); print(c.driver); c.release()"
    found = subprocess.run([sys.executable, "-c", asked], cwd=ROOT, env=environment, capture_output=True, text=True)
    if found.returncode or NAMES[driver] not in found.stdout:
        assert driver != "softpipe", found.stderr  # comes with llvmpipe
        pytest.skip(f"no {driver} here: {(found.stdout or found.stderr).strip().splitlines()[-1]}")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-k",
        SCENES,
        "tests/golden/test_contract.py",
    ]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and "3 passed" in done.stdout, done.stdout[-4000:]
