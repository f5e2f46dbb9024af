"""GL calls of a frame, counted one by one: of a moving and a still avatar, in an own and a foreign context."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from glsplat.gl import context as module
from glsplat.gl.context import create_context
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from tests.gl.tracing import Tracing
from tests.scenes import eyes, limb

pytestmark = pytest.mark.gl


def frame(renderer: Renderer, tracing: Tracing, angle: float) -> Counter[str]:
    tracing.counts()
    renderer.render(eyes(), Pose(np.full((4, 3), angle)))
    return tracing.counts()


@pytest.mark.parametrize(("foreign", "moving", "still"), [(False, 128, 74), (True, 263, 209)])
def test_calls_of_a_frame(foreign: bool, moving: int, still: int) -> None:
    """Llvmpipe's numbers, which no driver exceeds; a foreign context adds what saves and restores its state."""
    tracing = Tracing()
    ctx = tracing.context()
    context = create_context(given=ctx) if foreign else module._own(ctx, "egl")
    with Renderer(limb(), size=(64, 64), views=2, context=context) as renderer:
        for angle in (0.1, 0.2):
            frame(renderer, tracing, angle)
        first, second = frame(renderer, tracing, 0.3), frame(renderer, tracing, 0.3)
    context.release()
    if foreign:
        ctx.release()
    assert first["glReadPixels"] == second["glReadPixels"] == 2  # the counter works
    assert first.total() <= moving, first
    assert second.total() <= still, second
