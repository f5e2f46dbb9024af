"""Contract images and goldens on the other drivers that need no GPU, and tests as on a GPU, each in its own process.

Traps of GPU drivers that are known from other renderers, and what holds them here:

- gl_Layer in the vertex shader is missing on old NVIDIA and Intel drivers, broken on some of AMD's whose extension
  string has it: probed by rendering two pixels (gl/context.py); the geometry shader is tested beside it everywhere.
  Intel on Windows rejects it within gl_PerVertex: no shader redeclares that (test_shaders_avoid_what_differs).
- Sorts that count on subgroups of 32 are wrong on AMD, Intel, Apple and lavapipe: no shader uses a subgroup or a
  ballot (the same test). Places given out by atomics differ from run to run: tests of both sorters compare bytes.
- Storage: OpenGL 4.3 allows no blocks in vertex shaders (older Intel), and blocks of 128 MiB at most (Mesa):
  test_fetch.py draws without storage, and refuses what does not fit. Apple ends at OpenGL 4.1, as softpipe at 3.3 does:
  neither compute nor storage, tested below.
- 65,535 work groups are guaranteed a dispatch: at 512 splats a group and more that is twice what the splat texture
  holds (16,384 rows of 1,024), so no dispatch can exceed it.
- A framebuffer of layered and plain attachments is incomplete: colour and depth sum are both arrays
  (renderer/targets.py); meshes have targets of one view. Drawn by test_scene_pictures.py.
- NVIDIA's banding of premultiplied 8-bit targets, and 16F that rounds or cuts off: targets are floats, and 16F has a
  gate of its own. Fused multiply-adds change last bits: other drivers have wider gates than the maker's.
- Devices: EGL's order is not CUDA's, and GLCONTEXT_DEVICE_INDEX overrides arguments (_egl in gl/context.py names
  devices and hides the variable); containers without NVIDIA_DRIVER_CAPABILITIES=graphics have 0 devices, which is an
  error of one line. OSMesa is gone since Mesa 25.1: only a fallback.
"""

from __future__ import annotations

import os
import re
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

AS_ON_A_GPU = {
    "llvmpipe": [*PICTURES, "tests/renderer/test_renderer.py", "tests/renderer/test_sort.py"],
    "zink": [*PICTURES, "tests/renderer/test_sort.py"],
}
"""Without what is about 32F, the box that the CPU sorter finds, and the memory of its orders."""

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
for target in ("32f", LEAN.target):
    config = replace(LEAN, target=target, output="float32")
    with glsplat.Renderer(avatar, size=(160, 160), views=2, config=config) as renderer:
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
    exact, lean = -10 * np.log10(np.maximum(error, 1e-12)).reshape(2, 3).min(axis=1)
    assert exact > 80 and lean > 50  # drivers round 8 bits differently


@pytest.mark.parametrize("driver", DRIVERS)
def test_pictures(driver: str) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "not 16f", *PICTURES]
    environment = environment_of(driver)
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=280)
    passed = f"{2 * len(stored.NAMES) + len(CASES)} passed"
    assert done.returncode == 0 and passed in done.stdout and "skipped" not in done.stdout, done.stdout[-4000:]


@pytest.mark.parametrize("driver", AS_ON_A_GPU)
def test_as_on_a_gpu(driver: str) -> None:
    """16F targets, instanced quads from attributes, the GPU sorter: what a GPU chooses, on a software rasterizer."""
    chosen = "not check and not 32f and not quads-playbot and not covered_box and not new_memory"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", chosen, *AS_ON_A_GPU[driver]]
    environment = (dict(os.environ) if driver == "llvmpipe" else environment_of(driver)) | {
        "GLSPLAT_TESTS_AS_ON_A_GPU": "1"
    }
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and "skipped" not in done.stdout, done.stdout[-4000:]


def test_shaders_avoid_what_differs() -> None:
    for path in (ROOT / "glsplat").rglob("*.glsl"):
        assert not re.search(
            r"gl_PerVertex|subgroup[A-Z_]|shader_subgroup|gl_Sub[Gg]roup|ballot", path.read_text(encoding="utf-8")
        ), path
