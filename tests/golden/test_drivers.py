"""Contract images and goldens on the other drivers that need no GPU, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.golden import stored
from tests.golden.test_goldens import CASES

pytestmark = [pytest.mark.gl, pytest.mark.check]

ROOT = Path(__file__).resolve().parents[2]

DRIVERS = {
    "softpipe": {"GALLIUM_DRIVER": "softpipe"},  # OpenGL 3.3 only
    "osmesa": {"GLSPLAT_BACKEND": "osmesa"},
    "zink": {"GALLIUM_DRIVER": "zink", "LIBGL_ALWAYS_SOFTWARE": "1"},  # on Vulkan's lavapipe
}
NAMES = {"softpipe": "softpipe", "osmesa": "llvmpipe", "zink": "zink"}
PICTURES = ["tests/golden/test_contract.py::test_contract", "tests/golden/test_goldens.py::test_golden"]
"""At full precision, as a driver draws unasked and as quads; goldens at their wider gate."""

LEAN = """
import sys
from dataclasses import replace
import numpy as np
import glsplat
from glsplat.config import LEAN
from glsplat.formats.motion_files import load_motion
avatar = glsplat.default_avatar()
pose = load_motion("walk", avatar.skeleton).at(0.3)
pictures, levels = [], []
with glsplat.Renderer(avatar, size=(160, 160), views=2, config=replace(LEAN, output="float32")) as renderer:
    for away in (0.8, 1.6, 3.0):
        head = np.eye(4)
        head[:3, 3] = 0, 1.1, away
        pictures.append(renderer.render(glsplat.stereo_cameras(head, ipd=0.063, size=(160, 160)), pose))
        levels += renderer.stats.levels
np.savez(sys.argv[1], pictures=np.array(pictures), levels=levels, driver=renderer.driver)
"""


@cache
def asked(driver: str) -> tuple[dict[str, str], str]:
    """The variables with which a process draws on that driver, and what is wrong where it cannot."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GALLIUM", "GLSPLAT"))} | DRIVERS[driver]
    script = "import glsplat; c = glsplat.create_context(); print(c.driver); c.release()"
    found = subprocess.run([sys.executable, "-c", script], cwd=ROOT, env=environment, capture_output=True, text=True)
    missing = found.returncode or NAMES[driver] not in found.stdout
    said = (found.stdout or found.stderr).strip().splitlines() or [f"ended with {found.returncode}"]
    return environment, said[-1] if missing else ""


def environment_of(driver: str) -> dict[str, str]:
    environment, missing = asked(driver)
    if missing:
        assert driver != "softpipe", missing  # comes with llvmpipe
        pytest.skip(f"no {driver} here: {missing}")
    return environment


def lean_pictures(folder: Path, environment: dict[str, str]) -> dict[str, NDArray[Any]]:
    file = folder / "pictures.npz"
    subprocess.run([sys.executable, "-c", LEAN, file], cwd=ROOT, env=environment, check=True, capture_output=True)
    return dict(np.load(file))


@pytest.fixture(scope="module")
def pictures_here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, NDArray[Any]]:
    here = {k: v for k, v in os.environ.items() if not k.startswith("GLSPLAT")}
    return lean_pictures(tmp_path_factory.mktemp("here"), here)


@pytest.mark.parametrize("driver", DRIVERS)
def test_levels_and_hidden_splats(driver: str, tmp_path: Path, pictures_here: dict[str, NDArray[Any]]) -> None:
    """The same levels and the same pictures everywhere, with records pulled where a driver can, and without."""
    there = lean_pictures(tmp_path, environment_of(driver))
    assert NAMES[driver] in str(there["driver"])
    levels = pictures_here["levels"].tolist()
    assert levels == there["levels"].tolist() and len(set(levels)) >= 2
    error = ((pictures_here["pictures"].astype(np.float64) - there["pictures"]) ** 2).mean(axis=(1, 2, 3, 4))
    assert -10 * np.log10(np.maximum(error, 1e-12)).max() > 80


@pytest.mark.parametrize("driver", DRIVERS)
def test_pictures(driver: str) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "not 16f", *PICTURES]
    environment = environment_of(driver)
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=280)
    passed = f"{2 * len(stored.NAMES) + len(CASES)} passed"
    assert done.returncode == 0 and passed in done.stdout and "skipped" not in done.stdout, done.stdout[-4000:]
