"""Values show a picture of themselves in a notebook, and their repr where nothing can be drawn."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import glsplat
from glsplat.errors import ContextError
from glsplat.renderer import renderer
from tests.api.current_context import asked, nothing_current
from tests.scenes import cloud, limb


def decoded(png: bytes | None) -> NDArray[np.uint8]:
    assert png is not None
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED), np.uint8)


@pytest.mark.gl
@pytest.mark.parametrize("content", [cloud(300), limb(), glsplat.default_avatar()], ids=["splats", "limb", "person"])
def test_a_picture_of_the_whole_content(content: glsplat.Splats | glsplat.Avatar) -> None:
    nothing_current()
    image = decoded(content._repr_png_())
    assert image.shape == (512, 512, 4)
    alpha = image[..., 3]
    assert 0.02 < (alpha > 128).mean() < 0.7 and image[alpha > 128][:, :3].std() > 10
    assert not alpha[[0, -1]].any() and not alpha[:, [0, -1]].any()  # all of it, with a rim
    assert not asked()[0]  # its context is gone


@pytest.mark.gl
def test_content_without_splats_is_transparent() -> None:
    assert not decoded(cloud(3).take([])._repr_png_()).any()


def test_no_picture_without_opengl(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise ContextError("no OpenGL here")

    monkeypatch.setattr(renderer, "create_context", fail)
    assert cloud(3)._repr_png_() is None and limb()._repr_png_() is None


def test_a_repr_needs_no_renderer() -> None:
    program = "import glsplat, sys; repr(glsplat.default_avatar()); assert 'glsplat.renderer' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
