"""The programs that draw, once more on another rasterizer: Mesa's softpipe, in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.check

ROOT = Path(__file__).resolve().parents[2]
DRAWN = (
    "test_values.py::test_a_loop_that_moves_one_matrix_makes_different_cameras",
    "test_values.py::test_nan_written_into_the_source_later_changes_no_picture",
    "test_values.py::test_a_white_background_given_as_a_list_is_drawn",
    "test_values.py::test_quaternions_of_any_length_draw_the_same",
    "test_skins.py::test_a_skin_of_numpys_default_types_bends_like_the_same_in_the_renderers",
    "test_skins.py::test_any_number_of_influences_up_to_eight",
)


@pytest.mark.gl
def test_the_same_holds_on_softpipe() -> None:
    env = {**os.environ, "GALLIUM_DRIVER": "softpipe"}
    driver = "import glsplat; c = glsplat.create_context(); print(c.driver); c.release()"
    found = subprocess.run(
        [sys.executable, "-c", driver], cwd=ROOT, env=env, capture_output=True, text=True, check=True
    )
    assert "softpipe" in found.stdout
    tests = [f"tests/api/{name}" for name in DRAWN]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0 and "12 passed" in done.stdout, done.stdout[-3000:] + done.stderr[-1000:]
