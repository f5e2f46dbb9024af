"""The depth order: contract of both sorters, and knobs that let an old order stand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import moderngl
import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig, with_fields
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.renderer.gpu_sort import GpuSorter
from glsplat.renderer.sort import FIRST_CULLED, count_culled, covered_box, sorted_indices
from glsplat.shaders import Programs
from glsplat.splats import Splats
from tests.scenes import camera, cloud, eyes


def keys_of(depths: np.ndarray) -> np.ndarray:
    bits = depths.astype(np.float32).view(np.uint32)
    return np.where(bits >> 31, ~bits, bits | np.uint32(0x80000000)).astype(np.uint32)


def test_far_to_near_lower_index_nearer() -> None:
    order = sorted_indices(keys_of(np.array([1.0, 3.0, 2.0, 3.0, 1.0, -5.0])))
    assert order.tolist() == [3, 1, 2, 4, 0, 5]


def test_all_32_bits_count() -> None:
    depths = np.nextafter(np.float32(5), np.float32(9)) + np.zeros(3, np.float32)
    depths[1] = np.float32(5)
    depths[2] = 1e6  # an outlier takes no precision from the others
    assert sorted_indices(keys_of(depths)).tolist() == [2, 0, 1]
    assert sorted_indices(keys_of(depths), bits=16).tolist() == [2, 1, 0]


def test_culled_are_dropped_and_counted() -> None:
    keys = keys_of(np.array([1.0, 2.0, 3.0]))
    keys[1] = FIRST_CULLED + 2
    assert sorted_indices(keys).tolist() == [2, 0]
    assert count_culled(keys) == {"out of range": 0, "transparent": 1, "degenerate": 0, "outside": 0, "hidden": 0}
    assert sorted_indices(np.array([], np.uint32)).tolist() == []


@pytest.mark.gl
@pytest.mark.parametrize("count", [1, 2, 1023, 1024, 1025, 70001])
@pytest.mark.parametrize("bits", [16, 32])
def test_gpu_sorter_gives_the_same_order(context: Context, rng: np.random.Generator, count: int, bits: int) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    keys = keys_of(np.round(rng.normal(3, 2, count), 2))  # thousands of equal depths
    keys[rng.random(count) < 0.2] = FIRST_CULLED + 4
    costs = rng.integers(0, 2**23, count, np.uint32)  # their sum does not fit into 32 bits
    with context.ctx:
        programs = Programs(context.ctx)
        buffers = [
            context.ctx.buffer(keys),
            context.ctx.buffer(reserve=count * 4),
            context.ctx.buffer(np.stack([np.full(count, 7, np.uint32), costs], axis=1)),  # tiles, cost
        ]
        sorter = GpuSorter(context.ctx, programs, *buffers, count, 2, bits)
        sorter.run()
        drawn, culled, cost = sorter.counts()
        order = np.frombuffer(buffers[1].read(), np.uint32)[:drawn]
        expected = sorted_indices(keys, bits)
        assert cost == costs.sum(dtype=np.uint64)
        assert np.array_equal(order, expected) and culled == count_culled(keys)
        for item in (sorter, programs, *buffers):
            item.release()


def test_covered_box() -> None:
    tiles = np.array([[10, 20, 30, 40], [5, 25, 12, 255]], np.uint8).view(np.uint32)[:, 0]
    assert covered_box(tiles, 256, 256) == (4, 19, 28, 237)  # with a rim of one pixel, up to the edge
    assert covered_box(tiles, 1000, 100) == (18, 6, 105, 94)  # rounded outwards
    assert covered_box(tiles[:0], 64, 64) == (0, 0, 0, 0)


Make = Callable[..., Renderer]


def orbit(frame: int) -> tuple[Camera, ...]:
    turn = look_at((np.sin(0.7 * frame), 0, np.cos(0.7 * frame)), (0, 0, 0))
    turn[:3, 3] = 0
    return tuple(replace(view, viewmat=view.viewmat @ turn) for view in eyes())


@pytest.mark.gl
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


@pytest.mark.gl
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


@pytest.mark.gl
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


@pytest.mark.gl
@pytest.mark.parametrize("software", [True, False])
def test_orders_are_written_into_new_memory(
    renderer_of: Make, context: Context, monkeypatch: pytest.MonkeyPatch, software: bool
) -> None:
    """On a GPU the order's memory is given up before it is written anew: the same pictures, whoever still reads."""
    orphaned = []
    real = moderngl.Buffer.orphan
    monkeypatch.setattr(moderngl.Buffer, "orphan", lambda self, size=-1: orphaned.append(self) or real(self, size))
    expected = [renderer_of(cloud(800), views=2).render(eyes(distance=d)) for d in (2.0, 3.0, 2.5)]
    config = with_fields(RenderConfig(), output="float32", target="32f", shape="triangle", sorter="cpu")
    gpu = replace(context, software=software)  # as if
    with Renderer(cloud(800), size=(64, 64), views=2, config=config, context=gpu) as renderer:
        for distance, wanted in zip((2.0, 3.0, 2.5), expected, strict=True):
            assert np.array_equal(renderer.render(eyes(distance=distance)), wanted)
    assert len(orphaned) == (0 if software else 3)
