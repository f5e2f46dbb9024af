"""The depth order: contract of both sorters, and knobs that let an old order stand."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from weakref import WeakKeyDictionary

import moderngl
import numpy as np
import pytest

from glsplat.camera import Camera, look_at
from glsplat.config import RenderConfig, with_fields
from glsplat.errors import ContextError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer, gpu_sort
from glsplat.renderer.gpu_sort import TILE, GpuSorter
from glsplat.renderer.owned import owned
from glsplat.renderer.sort import FIRST_CULLED, count_culled, covered_box, sorted_indices
from glsplat.shaders import Programs
from glsplat.splats import Splats
from tests.scenes import camera, cloud, eyes

Ranges = list[tuple[int, int]]


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


def depths_of(rng: np.random.Generator, kind: str, count: int) -> np.ndarray:
    if kind == "equal":
        return np.full(count, 2.0)
    if kind == "outlier":
        return np.append(rng.normal(2, 1e-3, count - 1), 1e6) if count else np.empty(0)
    depths = np.round(rng.normal(3, 2, count), 2)  # thousands of equal ones, some behind the camera
    return depths if kind == "random" else np.sort(depths)[:: 1 if kind == "sorted" else -1]


def gpu_order(
    context: Context, keys: np.ndarray, costs: np.ndarray, bits: int = 32, ranges: Ranges | None = None
) -> tuple[np.ndarray, object, int]:
    """Sort on the GPU, twice with the same sorter; return the order, the culled and the cost."""
    count = len(keys)
    scratch = np.full(max(1, 7 * count), 7, np.uint32)
    scratch[: 3 * count] = np.stack([keys, keys * 0 + 7, costs], axis=1).reshape(-1)  # key, tiles, cost
    with context.ctx, ExitStack() as stack:
        programs = owned(stack, Programs(context.ctx))
        order, rows = (owned(stack, context.ctx.buffer(data)) for data in (scratch[: max(1, count)], scratch))
        sorter = owned(stack, GpuSorter(context.ctx, programs, order, rows, count, 2, bits))
        for _ in range(2):
            sorter.run(ranges or [(0, count)])
        drawn, culled, cost = sorter.counts()
        assert rows.read()[: 12 * count] == scratch[: 3 * count].tobytes()
        return np.frombuffer(order.read(), np.uint32)[:drawn], culled, cost


@pytest.mark.gl
@pytest.mark.parametrize("bits", [16, 32])
@pytest.mark.parametrize(
    ("kind", "count"),
    [
        *(("random", count) for count in (0, 1, 2, 31, 32, 33, 255, 256, 257, TILE - 1, TILE, TILE + 1, 70001)),
        *((kind, 2 * TILE + 5) for kind in ("equal", "sorted", "reversed", "outlier")),
        pytest.param("random", 1_000_000, marks=pytest.mark.check),
    ],
)
def test_gpu_sorter_gives_the_same_order(
    context: Context, rng: np.random.Generator, kind: str, count: int, bits: int
) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    keys = keys_of(depths_of(rng, kind, count))
    keys[rng.random(count) < 0.2] = FIRST_CULLED + 4
    costs = rng.integers(0, 2**23, count, np.uint32)  # their sum does not fit into 32 bits
    order, culled, cost = gpu_order(context, keys, costs, bits)
    drawn = np.flatnonzero(keys < FIRST_CULLED)
    assert np.array_equal(order, drawn[np.argsort(keys[drawn] >> (32 - bits), kind="stable")[::-1]])
    assert np.array_equal(order, sorted_indices(keys, bits))
    assert culled == count_culled(keys) and cost == costs.sum(dtype=np.uint64)


@pytest.mark.gl
def test_gpu_sorter_without_a_drawn_splat(context: Context) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    keys = FIRST_CULLED + np.arange(TILE + 3, dtype=np.uint32) % 8
    order, culled, _ = gpu_order(context, keys, keys * 0)
    assert not len(order) and culled == count_culled(keys)


@pytest.mark.gl
def test_gpu_sorter_numbers_the_splats_of_ranges(context: Context, rng: np.random.Generator) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    keys = keys_of(np.round(rng.normal(3, 2, 5 * 1024), 1))
    order, _, _ = gpu_order(context, keys, keys * 0, ranges=[(1024, 2048), (7 * 1024, 3072)])
    assert np.array_equal(order, np.r_[1024:3072, 7168:10240][sorted_indices(keys)])


@pytest.mark.gl
def test_gpu_sorter_dispatches_twice_a_digit(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also writes the order at the highest digit that differs, so that equal depths fill no list."""
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    dispatched: list[int] = []
    real = moderngl.ComputeShader.run
    monkeypatch.setattr(moderngl.ComputeShader, "run", lambda self, n: dispatched.append(n) or real(self, n))
    keys = np.full(3000, 0xC0000000, np.uint32)
    scratch = np.full(7 * 3000, 9, np.uint32)
    scratch[:9000:3] = keys
    with context.ctx, ExitStack() as stack:
        programs = owned(stack, Programs(context.ctx))
        order, rows = (owned(stack, context.ctx.buffer(data)) for data in (keys, scratch))
        sorter = owned(stack, GpuSorter(context.ctx, programs, order, rows, 3000, 1))
        sorter.run([(0, 3000)])
        assert np.frombuffer(order.read(), np.uint32).tolist() == list(range(2999, -1, -1))
        assert rows.read() == scratch.tobytes()
    assert dispatched == [2] * 8  # count and scatter of four digits, two tiles


@pytest.mark.gl
@pytest.mark.parametrize("faster", [True, False])
def test_a_gpu_measures_once_which_sorter_is_faster(
    context: Context, monkeypatch: pytest.MonkeyPatch, faster: bool
) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    measured: list[int] = []
    monkeypatch.setattr(gpu_sort, "_faster", WeakKeyDictionary())
    monkeypatch.setattr(gpu_sort, "_measured", lambda ctx, programs, count: measured.append(count) or faster)
    sorted_by_gpu: list[object] = []
    real = GpuSorter.run
    monkeypatch.setattr(GpuSorter, "run", lambda self, ranges: sorted_by_gpu.append(self) or real(self, ranges))
    pictures = []
    for software, sorter in ((False, "auto"), (False, "auto"), (False, "cpu"), (False, "gpu"), (True, "auto")):
        config = with_fields(RenderConfig(), sorter=sorter, target="32f", shape="triangle", fetch="attributes")
        driver = replace(context, software=software)  # as if
        with Renderer(cloud(800), size=(64, 64), config=config, context=driver) as renderer:
            pictures.append(renderer.render([camera()]))
    assert measured == [1024] and len(sorted_by_gpu) == (3 if faster else 1)
    assert pictures[0].any() and all(np.array_equal(pictures[0], other) for other in pictures)


@pytest.mark.gl
def test_the_measurement_sorts_on_both(context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    times = iter([1.0, 2.0, 4.0, 3.0])
    monkeypatch.setattr(gpu_sort, "_least_ms", lambda ctx, step: step() or next(times))
    with context.ctx:
        programs = Programs(context.ctx)
        assert [gpu_sort._measured(context.ctx, programs, 1024) for _ in range(2)] == [True, False]
        assert gpu_sort.gpu_sorts_faster(replace(context, software=False), programs, 10**6)
        programs.release()


@pytest.mark.gl
def test_buffers_above_the_driver_s_limit_are_sorted_on_the_cpu(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    monkeypatch.setitem(context.ctx.info, "GL_MAX_SHADER_STORAGE_BLOCK_SIZE", 4096)
    monkeypatch.setattr(gpu_sort, "_measured", lambda *_: pytest.fail("measured"))
    driver = replace(context, software=False)
    with Renderer(cloud(800), size=(64, 64), context=driver) as renderer:
        assert renderer.render([camera()]).any()
    with Renderer(cloud(800), size=(64, 64), config=RenderConfig(sorter="gpu"), context=driver) as renderer:
        with pytest.raises(ContextError, match="800 splats exceed this driver's 4096 byte buffers"):
            renderer.render([camera()])


def test_a_dispatch_has_fewer_groups_than_drivers_allow() -> None:
    assert gpu_sort._groups(0) == 1 and gpu_sort._groups(TILE + 1) == 2
    assert gpu_sort._groups(2**31) < 65536


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
