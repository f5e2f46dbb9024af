"""Budgets: the cost of a picture before it is drawn, refusal, slices, and pictures given up half-way."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import BudgetError
from glsplat.net.backends.gl import PictureBudget
from glsplat.renderer.draw import DrawPass
from glsplat.splats import Splats

SIZE = (160, 96)


def scene(rng: np.random.Generator, count: int = 300) -> Splats:
    """Sizes from a hundredth of a pixel to the whole picture."""
    return splats(
        rng.uniform(-1, 1, (count, 3)),
        rng.normal(size=(count, 4)),
        10 ** rng.uniform(-4, -0.3, (count, 3)),
        rng.uniform(0.01, 1, count),
        rng.normal(size=(count, 1, 3)),
    )


def splats(*arrays: np.ndarray) -> Splats:
    return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def pair(distance: float = 2.5) -> list[Camera]:
    views = [look_at((x, 0.2, distance), (0, 0, 0)) for x in (-0.3, 0.3)]
    return [Camera(view, pinhole(*SIZE), *SIZE) for view in views]


@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
@pytest.mark.parametrize("layers", ["vertex", "geometry"])
@pytest.mark.parametrize("output", ["uint8", "float32"])
def test_slices_make_the_same_picture(renderer_of, context, rng, sorter, layers, output) -> None:
    if (sorter == "gpu" and not context.compute) or (layers == "vertex" and not context.vertex_layers):
        pytest.skip("this driver cannot")
    renderer = renderer_of(scene(rng), size=SIZE, sorter=sorter, layers=layers, output=output)
    for views in (pair(), pair()[:1]):
        whole = PictureBudget().render(renderer.prepare(views))
        cost = renderer.stats.cost
        for pieces in (1.5, 7, 40, 1e9):
            asked = iter(range(10**6))  # how often
            slices = PictureBudget(slice_cost=cost / pieces, abandoned=lambda asked=asked: next(asked) < 0)
            np.testing.assert_array_equal(slices.render(renderer.prepare(views)), whole)
            assert next(asked) >= min(pieces, 30) / 3
        np.testing.assert_array_equal(renderer.render(views), whole)


@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
@pytest.mark.parametrize("fetch", ["attributes", "storage"])
def test_slices_end_where_the_records_do(renderer_of, context, rng, monkeypatch, sorter, fetch) -> None:
    """Records of a fuller picture still lie behind them."""
    if (sorter == "gpu" and not context.compute) or (fetch == "storage" and not context.vertex_storage):
        pytest.skip("this driver cannot")
    renderer = renderer_of(scene(rng), size=SIZE, sorter=sorter, fetch=fetch)
    aside = [Camera(look_at((0, 0, 2.5), (1.6, 0, 0)), pinhole(*SIZE), *SIZE)]
    whole = PictureBudget().render(renderer.prepare(aside))
    drawn, cost = renderer.stats.drawn, renderer.stats.cost
    renderer.render(pair()[:1])
    assert renderer.stats.drawn > drawn + 20
    ends: list[int] = []
    run_slices = DrawPass.run_slices

    def noted(self, target, at, between) -> None:
        ends.extend(at)
        run_slices(self, target, at, between)

    monkeypatch.setattr(DrawPass, "run_slices", noted)
    slices = PictureBudget(slice_cost=cost / 5, abandoned=lambda: False)
    np.testing.assert_array_equal(slices.render(renderer.prepare(aside)), whole)
    assert len(ends) >= 4 and ends == sorted(ends) and ends[-1] == drawn


def test_both_sorters_count_the_same(renderer_of, context, rng) -> None:
    if not context.compute:
        pytest.skip("no OpenGL 4.3")
    costs = []
    for sorter in ("cpu", "gpu"):
        renderer = renderer_of(scene(rng=np.random.default_rng(3)), size=SIZE, sorter=sorter)
        for distance in (2.5, 1.2, 0.4):
            PictureBudget().render(renderer.prepare(pair(distance)))
            costs.append(renderer.stats.cost)
    assert costs[:3] == costs[3:] and costs[0] < min(costs[1:3])


def test_the_cost_is_the_covered_pixels(renderer_of) -> None:
    """One splat at a time: the pixels that differ from the background, within the rim of blocks of 4x4."""
    for scale in (0.001, 0.02, 0.1, 0.3, 3.0):
        one = splats(
            np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.full((1, 3), scale), np.ones(1), np.ones((1, 1, 3))
        )
        renderer = renderer_of(one, size=SIZE)
        image = PictureBudget().render(renderer.prepare(pair()[:1]))[0]
        rows, columns = np.nonzero(image[..., 3])
        height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
        cost = renderer.stats.cost
        assert height * width <= cost <= min((height + 10) * (width + 10), SIZE[0] * SIZE[1])
        PictureBudget().render(renderer.prepare(pair()))
        assert cost * 1.2 < renderer.stats.cost or scale > 1


@pytest.mark.parametrize("sorter", ["cpu", "gpu"])
def test_a_refused_picture_costs_nothing_and_changes_nothing(renderer_of, context, rng, sorter) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("no OpenGL 4.3")
    renderer = renderer_of(scene(rng), size=SIZE, sorter=sorter)
    near, far = pair(1.0), pair(4.0)
    expected = renderer.render(near), renderer.render(far)
    PictureBudget().render(renderer.prepare(far))
    cap = renderer.stats.cost
    for _ in range(3):
        with pytest.raises(BudgetError, match=r"covers .* pixels splat by splat, at most") as caught:
            PictureBudget(max_cost=cap).render(renderer.prepare(near))
        assert caught.value.code == "too_costly" and "draw" not in renderer.timings
    np.testing.assert_array_equal(renderer.render(near), expected[0])
    np.testing.assert_array_equal(PictureBudget(max_cost=cap).render(renderer.prepare(far)), expected[1])


def test_two_passes_share_one_budget(renderer_of, rng) -> None:
    """Views that do not look the same way are drawn one after the other."""
    renderer = renderer_of(scene(rng), size=SIZE)
    around = [Camera(look_at(eye, (0, 0, 0)), pinhole(*SIZE), *SIZE) for eye in ((0, 0, 3.0), (3.0, 0, 0.01))]
    PictureBudget().render(renderer.prepare(around))
    both = renderer.stats.cost
    PictureBudget().render(renderer.prepare(around[:1]))
    assert renderer.stats.cost < both
    with pytest.raises(BudgetError):
        PictureBudget(max_cost=both - 1).render(renderer.prepare(around))
    PictureBudget(max_cost=both).render(renderer.prepare(around))


@pytest.mark.parametrize("why", ["too_slow", "abandoned"])
def test_a_picture_is_given_up_between_two_slices(renderer_of, rng, why) -> None:
    renderer = renderer_of(scene(rng), size=SIZE)
    near, far = pair(1.0), pair(4.0)
    expected = renderer.render(near), renderer.render(far)
    PictureBudget().render(renderer.prepare(near))
    now, asked = [0.0], []

    def clock() -> float:
        now[0] += 1.0
        return now[0]

    def abandoned() -> bool:
        asked.append(0)
        return why == "abandoned" and len(asked) == 4

    budget = PictureBudget(seconds=4.5, slice_cost=renderer.stats.cost / 20, abandoned=abandoned, clock=clock)
    with pytest.raises(BudgetError) as caught:
        budget.render(renderer.prepare(near))
    assert caught.value.code == why and 3 <= len(asked) <= 5
    np.testing.assert_array_equal(renderer.render(near), expected[0])
    np.testing.assert_array_equal(renderer.render(far), expected[1])
