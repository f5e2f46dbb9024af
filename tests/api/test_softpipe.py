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

from glsplat.gl.context import create_context

pytestmark = [pytest.mark.gl, pytest.mark.check]

DRAWN = (
    "test_contexts.py::test_every_pair_of_kinds_in_turn[own contexts]",
    "test_contexts.py::test_every_call_gives_back_what_was_current",
    "test_state.py::test_pictures_and_state[everything]",
    "test_values.py::test_a_loop_that_moves_one_matrix_makes_different_cameras",
    "test_values.py::test_nan_written_into_the_source_later_changes_no_picture",
    "test_values.py::test_quaternions_of_any_length_draw_the_same",
    "test_values.py::test_a_skin_of_numpys_default_types_bends_like_the_same_in_the_renderers",
    "test_values.py::test_any_number_of_influences_up_to_eight",
    "test_softpipe.py::test_the_driver",
)
SOFTPIPE = os.environ.get("GALLIUM_DRIVER") == "softpipe"


@pytest.mark.skipif(not SOFTPIPE, reason="run by the test below")
def test_the_driver() -> None:
    context = create_context()
    assert "softpipe" in context.driver
    context.release()


@pytest.mark.skipif(SOFTPIPE, reason="this is softpipe")
def test_the_same_holds_on_softpipe() -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"tests/api/{name}" for name in DRAWN)]
    environment, root = os.environ | {"GALLIUM_DRIVER": "softpipe"}, Path(__file__).parents[2]
    done = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and "skipped" not in done.stdout, done.stdout[-4000:]
