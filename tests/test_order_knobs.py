"""Knobs that trade a stale or incomplete drawing order for time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.context import Context
from glsplat.errors import GlsplatError
from glsplat.renderer import Renderer
from tests.scenes import cloud, eyes

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]


def orbit(frame: int) -> tuple[Camera, ...]:
    turn = look_at((np.sin(0.7 * frame), 0, np.cos(0.7 * frame)), (0, 0, 0))
    turn[:3, 3] = 0
    return tuple(replace(view, viewmat=view.viewmat @ turn) for view in eyes())


@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
def test_an_old_order_is_kept_for_a_period_and_never_at_rest(renderer_of: Make, context: Context, sorter: str) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("no OpenGL 4.3: there is no GPU sorter")
    scene = cloud(3000)
    lazy, exact = (renderer_of(scene, views=2, sorter=sorter, sort_period=n) for n in (3, 1))
    for frame in range(7):
        pictures = lazy.render(orbit(frame)), exact.render(orbit(frame))
        assert lazy.stats.sorted == (frame % 3 == 0) and exact.stats.sorted
        assert np.array_equal(*pictures) == (frame % 3 == 0)  # in between the order is wrong, and shows
        assert pictures[0].any()
    held = orbit(7)
    stale = lazy.render(held)
    assert np.array_equal(lazy.render(held), exact.render(held)) and lazy.stats.sorted  # stands still: sorted now
    assert not np.array_equal(stale, exact.render(held))
    assert lazy.render(held).any() and not lazy.stats.sorted


@pytest.mark.parametrize("period", [0, -1, 1001, 1.5])
def test_sort_period_is_checked(period: float) -> None:
    with pytest.raises(GlsplatError, match="sort_period needs 1 to 1000"):
        RenderConfig(sort_period=period)  # type: ignore[arg-type]
