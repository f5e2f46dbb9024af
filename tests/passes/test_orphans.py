"""On a GPU the order's memory is given up before it is written anew: the same pictures, whoever is still reading."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from glsplat.config import RenderConfig
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from tests.scenes import cloud, eyes

pytestmark = pytest.mark.gl
Make = Callable[..., Renderer]


@pytest.mark.parametrize("software", [True, False])
def test_orders_are_written_into_new_memory(
    renderer_of: Make, context: Context, monkeypatch: pytest.MonkeyPatch, software: bool
) -> None:
    orphaned = []
    real = moderngl.Buffer.orphan
    monkeypatch.setattr(moderngl.Buffer, "orphan", lambda self, size=-1: orphaned.append(self) or real(self, size))
    expected = [renderer_of(cloud(800), views=2).render(eyes(distance=d)) for d in (2.0, 3.0, 2.5)]
    config = RenderConfig(output="float32", target="32f", shape="triangle", sorter="cpu")
    gpu = replace(context, software=software)  # as if
    with Renderer(cloud(800), size=(64, 64), views=2, config=config, context=gpu) as renderer:
        for distance, wanted in zip((2.0, 3.0, 2.5), expected, strict=True):
            assert np.array_equal(renderer.render(eyes(distance=distance)), wanted)
    assert len(orphaned) == (0 if software else 3)
