"""Imported by the child of a test."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from glsplat.renderer import Renderer
from tests.scenes import cloud, eyes


def picture() -> NDArray[Any]:
    """A pair of views."""
    with Renderer(cloud(), size=(64, 64)) as renderer:
        return renderer.render(eyes())
