"""The depth order: contract of both sorters."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.gl.context import Context
from glsplat.passes.frame.gpu_sort import GpuSorter
from glsplat.passes.frame.sort import FIRST_CULLED, count_culled, covered_box, sorted_indices
from glsplat.shaders import Programs


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
    assert covered_box(tiles[:0], 64, 64) == (0, 0, 1, 1)
