"""Pictures that leave items out, items that fade, and levels of detail that several viewers share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.detail.selector import Selector
from glsplat.errors import GlsplatError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.splats import Splats
from tests.scene.test_levels import leveled, leveled_limb, seen_from
from tests.scene.worlds import random_pose, upright
from tests.scenes import camera, cloud, eyes, limb

Make = Callable[..., Renderer]
SORTERS = ("cpu", "gpu")


@pytest.mark.gl
@pytest.mark.parametrize("sorter", SORTERS)
def test_what_is_left_out_is_as_if_it_were_not_there(renderer_of: Make, context: Context, sorter: str) -> None:
    if sorter == "gpu" and not context.compute:
        pytest.skip("this driver has no compute shaders")
    rod, mist = Item(limb(200, degree=1)), Item(cloud(1500, 2))
    extra = Item(cloud(150, seed=4), transform=similarity((0, 0.3, 0)))
    screen = Item(upright(0.1, 0.5, (200, 30, 30)))
    scene = Scene([rod, mist, extra, screen])
    renderer = renderer_of(scene, views=2, sorter=sorter)
    renderer.render(eyes())
    made = renderer._staged.arenas if renderer._staged else 0
    for out in ([mist], [rod, extra], [screen], [rod, mist, extra], [], [rod, mist, extra, screen], [extra]):
        for item in scene:
            item.layers = 1
        rest = Scene(item for item in scene if item not in out)
        config = RenderConfig(output="float32", sorter=sorter)
        with Renderer(rest, size=(64, 64), config=config, context=context) as alone:
            wanted = alone.prepare(eyes()).render()
            expected = alone.stats
        for item in scene:
            item.layers = 2 if item in out else 1
        assert np.array_equal(renderer.prepare(eyes()).render(), wanted)
        now = renderer.stats
        assert (now.splats, now.drawn, now.culled, now.cost) == (
            *(expected.splats, expected.drawn, expected.culled, expected.cost),
        )
    assert renderer._staged is not None and renderer._staged.arenas == made


@pytest.mark.gl
def test_an_old_order_is_not_taken_for_another_selection(renderer_of: Make) -> None:
    one, two = Item(cloud(300)), Item(cloud(300, seed=7), transform=similarity((0.1, 0, 0)))
    renderer, new = (renderer_of(Scene([one, two]), sort_period=4) for _ in range(2))
    renderer.render([camera()])
    one.transform = similarity((0, 0.01, 0))
    two.layers = 2
    assert np.array_equal(renderer.render([camera()]), new.render([camera()]))


@pytest.mark.gl
def test_opacity_multiplies(renderer_of: Make) -> None:
    def faded(splats: Splats, share: float) -> Splats:
        return Splats(splats.means, splats.quats, splats.scales, splats.opacities * np.float32(share), splats.sh)

    thing = cloud(300)
    assert thing.opacities.max() <= 1
    item = Item(thing, opacity=0.25)
    renderer = renderer_of(Scene([item]))
    expected = renderer_of(faded(thing, 0.25)).render([camera()])
    assert np.allclose(renderer.render([camera()]), expected, atol=2e-6)
    item.opacity = 1
    assert np.array_equal(renderer.render([camera()]), renderer_of(thing).render([camera()]))
    item.opacity = 0
    assert not renderer.render([camera()]).any()
    for wrong in (-0.1, 1.5, float("nan"), "half"):
        with pytest.raises(GlsplatError, match="opacity needs"):
            item.opacity = wrong  # type: ignore[assignment]


@pytest.mark.gl
def test_an_item_is_posed_once_for_all_viewers(renderer_of: Make) -> None:
    """Viewers near and far in turn: each level that is in use is posed once a movement."""
    items = [Item(leveled_limb()), Item(leveled_limb(), transform=similarity((0, 0, -4)))]
    renderer = renderer_of(Scene(items), level="auto")
    places = {"near": 2.0, "far": 12.0, "behind": -6.0}
    levels, selectors = {}, {name: Selector() for name in places}
    for name, distance in places.items():
        renderer.selector = selectors[name]
        renderer.render([seen_from(distance)])
        levels[name] = renderer.stats.levels
    assert len(set(levels.values())) == 3
    in_use = {(i, level) for chosen in levels.values() for i, level in enumerate(chosen)}
    made = renderer._staged.arenas
    for tick in range(5):
        for i, item in enumerate(items):
            item.pose = random_pose(4, 10 * tick + i)
        posed = 0
        for _ in range(3):
            for name, distance in places.items():
                renderer.selector = selectors[name]
                renderer.render([seen_from(distance)])
                assert renderer.stats.levels == levels[name]
                posed += renderer.stats.posed
        assert posed == len(in_use)
    assert renderer._staged.arenas == made


@pytest.mark.gl
def test_who_comes_does_not_make_the_others_flicker(renderer_of: Make) -> None:
    """Between two levels the one it had counts, also when another item has come meanwhile."""
    scene = Scene([Item(leveled())])
    renderer = renderer_of(scene, level="auto")
    renderer.render([seen_from(3.0)])
    assert renderer.stats.levels == (0,)
    scene.add(Item(leveled(), transform=similarity((0, 0, -30))))
    renderer.render([seen_from(4.02)])
    assert renderer.stats.levels == (0, 2)


def test_a_part_and_the_rest_are_the_whole() -> None:
    person = default_avatar()
    rest, head = person.without("head"), person.only("head")
    assert len(rest.splats) + len(head.splats) == len(person.splats)
    together = np.concatenate([rest.splats.means, head.splats.means])
    assert np.array_equal(np.sort(together, axis=0), np.sort(person.splats.means, axis=0))
    assert head.skeleton is person.skeleton and len(head.levels) == len(person.levels) == 3
    assert head.splats.means[:, 1].min() > rest.splats.means[:, 1].mean()


@pytest.mark.gl
def test_a_person_in_two_parts_looks_like_one(renderer_of: Make) -> None:
    person, pose = limb(400), random_pose(4, 5)
    joint = person.skeleton.names[2]
    parts = Scene([Item(person.without(joint), pose=pose), Item(person.only(joint), pose=pose)])
    whole = renderer_of(Scene([Item(person, pose=pose)])).render([camera()])
    assert np.abs(renderer_of(parts).render([camera()]) - whole).max() < 1e-5
