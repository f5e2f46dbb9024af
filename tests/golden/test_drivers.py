"""The contract images on the other drivers that need no GPU, each in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
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

LEAN = """
import sys
from dataclasses import replace
import numpy as np
import glsplat
from glsplat.config import LEAN
from glsplat.motion.motion import load_motion
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


def environment_of(driver: str) -> dict[str, str]:
    """The variables with which a process draws on that driver; skips where there is none."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("GALLIUM", "GLSPLAT"))} | DRIVERS[driver]
    asked = "import glsplat; c = glsplat.create_context(); print(c.driver); c.release()"
    found = subprocess.run([sys.executable, "-c", asked], cwd=ROOT, env=environment, capture_output=True, text=True)
    if found.returncode or NAMES[driver] not in found.stdout:
        assert driver != "softpipe", found.stderr  # comes with llvmpipe
        pytest.skip(f"no {driver} here: {(found.stdout or found.stderr).strip().splitlines()[-1]}")
    return environment


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS)
def test_levels_and_hidden_splats(driver: str, tmp_path: Path) -> None:
    """The same levels and the same pictures everywhere, with records pulled where a driver can, and without."""
    environment, pictures = environment_of(driver), []
    here = {k: v for k, v in os.environ.items() if not k.startswith("GLSPLAT")}
    for name, variables in (("here", here), (driver, environment)):
        file = tmp_path / f"{name}.npz"
        subprocess.run([sys.executable, "-c", LEAN, file], cwd=ROOT, env=variables, check=True, capture_output=True)
        pictures.append(dict(np.load(file)))
    assert NAMES[driver] in str(pictures[1]["driver"])
    levels = pictures[0]["levels"].tolist()
    assert levels == pictures[1]["levels"].tolist() and len(set(levels)) >= 2
    error = ((pictures[0]["pictures"].astype(np.float64) - pictures[1]["pictures"]) ** 2).mean(axis=(1, 2, 3, 4))
    assert -10 * np.log10(np.maximum(error, 1e-12)).max() > 80


@pytest.mark.gl
@pytest.mark.shared
@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS)
def test_contract_images(driver: str, shared_data: Path) -> None:
    environment = environment_of(driver)
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
