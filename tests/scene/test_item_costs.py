"""What each item of a picture costs, and the finest level of detail at which it may be drawn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from tests.scene.test_levels import leveled, seen_from
from tests.scene.worlds import random_pose, upright
from tests.scenes import cloud, eyes, limb

Make = Callable[..., Renderer]
SORTERS = ("cpu", "gpu")


def needs_compute(sorter: str, context: Context) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("this driver has no compute shaders")


def around() -> list[Camera]:
    """Two views that are drawn one after the other."""
    return [Camera(look_at(eye, (0, 0, 0)), pinhole(64, 64), 64, 64) for eye in ((0, 0, 3.0), (3.0, 0, 0.01))]


@pytest.mark.gl
@pytest.mark.parametrize("sorter", SORTERS)
@pytest.mark.parametrize("views", [eyes, around])
def test_each_item_costs_what_it_costs_alone(
    renderer_of: Make, context: Context, sorter: str, views: Callable[[], list[Camera]]
) -> None:
    needs_compute(sorter, context)
    rod, mist, far = Item(limb(200)), Item(cloud(1500, 2)), Item(cloud(30, seed=4), transform=similarity((90, 0, 0)))
    scene = Scene([rod, mist, upright_item := Item(upright(0.1, 0.5, (200, 30, 30))), far])
    renderer = renderer_of(scene, views=2, sorter=sorter)
    for number in range(3):
        rod.pose = random_pose(4, number)
        for shown in ([rod, mist, far], [mist], [rod, far], [], [rod, mist, far]):
            for item in scene:
                item.layers = 1 if item in shown or item is upright_item else 2
            plain = renderer.prepare(views()).cost
            image = renderer.prepare(views()).render()
            prepared = renderer.prepare(views(), itemised=True)
            assert list(prepared.items) == shown and prepared.cost == plain
            assert sum(prepared.items.values()) == plain
            assert np.array_equal(prepared.render(), image)
            costs = prepared.items
            assert costs.get(far, 0) == 0
            for item in shown:
                for other in scene:
                    other.layers = 1 if other is item else 2
                assert renderer.prepare(views()).cost == costs[item]
            for item in scene:
                item.layers = 1


@pytest.mark.gl
def test_a_single_thing_and_nothing_have_costs_too(renderer_of: Make) -> None:
    mist = Item(cloud(300))
    renderer = renderer_of(Scene([mist]))
    prepared = renderer.prepare(eyes()[:1], itemised=True)
    assert prepared.items == {mist: prepared.cost} and prepared.cost > 0
    empty = renderer_of(Scene([]))
    assert empty.prepare(eyes()[:1], itemised=True).items == {}
    with pytest.raises(GlsplatError, match="itemised"):
        renderer.prepare(eyes()[:1], itemised="yes")  # type: ignore[arg-type]


@pytest.mark.gl
@pytest.mark.parametrize("level", [0, 1, "auto"])
def test_an_item_is_drawn_no_finer_than_it_may_be(renderer_of: Make, level: int | str) -> None:
    one, two = Item(leveled()), Item(leveled(), transform=similarity((0.2, 0, 0)))
    coarsest = len(one.content.levels)
    renderer = renderer_of(Scene([one, two]), level=level)
    near = [seen_from(0.7)]
    before = renderer.prepare(near, itemised=True)
    image, (free, _) = before.render(), renderer.stats.levels
    for finest in (*range(coarsest + 1), 99):
        one.finest = finest
        prepared = renderer.prepare(near, itemised=True)
        assert renderer.stats.levels == (max(free, min(finest, coarsest)), free)
        assert prepared.items[two] == before.items[two]
    assert not np.array_equal(prepared.render(), image)
    one.finest = 0
    assert np.array_equal(renderer.prepare(near).render(), image)
    for wrong in (-1, 0.5, "0"):
        with pytest.raises(GlsplatError, match="finest level"):
            one.finest = wrong  # type: ignore[assignment]
