"""Knobs that trade a stale or incomplete drawing order for time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.splats import Splats
from tests.scenes import camera, cloud, eyes

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


@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
def test_several_passes_of_a_frame_do_not_take_each_others_order(
    renderer_of: Make, context: Context, sorter: str
) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("no OpenGL 4.3: there is no GPU sorter")
    scene = cloud(1000)
    ring = [replace(camera(), viewmat=look_at((3 * np.sin(a), 0, 3 * np.cos(a)), (0, 0, 0))) for a in np.arange(0, 6)]
    lazy, exact = (renderer_of(scene, sorter=sorter, sort_period=n) for n in (3, 1))
    for _ in range(2):
        assert np.array_equal(lazy.render(ring), exact.render(ring)) and lazy.stats.sorted


def test_an_old_order_draws_nothing_outside_the_covered_box(renderer_of: Make) -> None:
    """What has become hidden since would colour the box's corner, from which the rest of the picture is filled."""
    scene = Splats.create(
        [[0, 0, 0], [-0.25, 0.25, 0]],
        [[1, 0, 0, 0]] * 2,
        [[0.1] * 3, [0.3] * 3],
        [0.9, 0.9],
        rgb=[[1, 0, 0], [0, 1, 0]],
    )
    scene = replace(scene, cones=np.array([[0, 0, 0, -127], [-45, 45, 127, 126]], np.int8))
    aside = replace(camera(), viewmat=look_at((-1.3, 1.3, 3), (0, 0, 0)))
    lazy, exact = (renderer_of(scene, cull_hidden=True, output="uint8", sorter="cpu", sort_period=n) for n in (3, 1))
    for view in (aside, camera()):
        assert np.array_equal(lazy.render([view]), exact.render([view]))
        assert lazy.stats.drawn == exact.stats.drawn
    assert not lazy.stats.sorted and lazy.stats.culled["hidden"] == 1


def test_knobs_are_checked() -> None:
    for knob in ({"antialias": "yes"}, {"cull_hidden": 2}):
        with pytest.raises(GlsplatError, match="needs one of"):
            RenderConfig(**knob)
    for period in (0, -1, 1001, 1.5):
        with pytest.raises(GlsplatError, match="sort_period needs"):
            RenderConfig(sort_period=period)


@pytest.mark.parametrize("software", [True, False])
def test_orders_are_written_into_new_memory(
    renderer_of: Make, context: Context, monkeypatch: pytest.MonkeyPatch, software: bool
) -> None:
    """On a GPU the order's memory is given up before it is written anew: the same pictures, whoever still reads."""
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
