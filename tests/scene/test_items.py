"""Items of one picture: left out, faded, far apart, and what each costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.errors import GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer, gpu_scene
from glsplat.renderer.levels import Selector
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from glsplat.splats import Splats
from glsplat.views import viewing_point
from tests.compare import Difference
from tests.light.lit import random_light
from tests.scene.test_levels import leveled, leveled_limb, seen_from
from tests.scene.test_mesh_samples import limb_mesh
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


TURN = similarity((0.1, -0.2, 0.1), rotation=(0.1, 0.3, 0.2, 0.9), scale=1.3)


@pytest.mark.gl
def test_a_placed_scene_is_seen_by_moved_cameras(renderer_of: Make) -> None:
    """To the bit, and as its items placed one by one; nothing is skinned again. Depth is in the cameras' metres."""
    own = [None, similarity((0.2, 0, 0), scale=0.5), similarity((0, 0.3, 0))]
    contents = [limb(200, degree=1), cloud(500, 2), upright(0.1, 0.5, (200, 30, 30))]
    still_scene = Scene([Item(one, transform=place) for one, place in zip(contents, own, strict=True)])
    scene = Scene(still_scene.items)
    still, placed = renderer_of(still_scene), renderer_of(scene)
    before = placed.render([camera()])
    scene.transform = TURN
    image, depth = placed.render([camera()], depth=True)
    assert placed.stats.posed == 0 and not np.array_equal(image, before)
    moved, moved_depth = still.render([camera().in_space(TURN)], depth=True)
    assert np.array_equal(image, moved) and np.allclose(depth, 1.3 * moved_depth)
    each = Scene(Item(item.content, transform=TURN @ item.transform) for item in scene)
    expected, expected_depth = renderer_of(each).render([camera()], depth=True)
    assert Difference.of(image, expected).psnr >= 70
    covered = expected[..., 3] > 0.5
    assert covered.sum() > 200 and np.abs(depth - expected_depth)[covered].max() < 1e-3
    scene.transform = np.eye(4)
    assert np.array_equal(placed.render([camera()]), before)
    with pytest.raises(GlsplatError, match="one scale for all axes"):
        scene.transform = np.diag([1, 2, 1, 1])
    assert np.array_equal(scene.transform, np.eye(4))


@pytest.mark.gl
def test_another_size_of_the_scene_leaves_static_items_on_the_gpu(
    renderer_of: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As tracking measures a user: only a person who moves is posed again. 400,000 splats take 70 ms to place."""
    person, scenery = Item(limb(200, degree=1)), Item(cloud(3000, 2), transform=similarity((0, 0.2, -0.5)))
    scene = Scene([scenery, person, Item(upright(0.1, 0.5, (200, 30, 30)))])
    renderer = renderer_of(scene, views=2)
    renderer.render(eyes())
    assert renderer.stats.posed == 2
    for kind in ("Arena", "ItemBuffers", "MeshBuffers"):  # nothing is uploaded any more
        monkeypatch.setattr(gpu_scene, kind, None)
    for size in (1.05, 0.9, 1.2):
        scene.transform = similarity((0, 0.01, 0), scale=size)
        renderer.render(eyes())
        assert renderer.stats.posed == 0
    person.pose = random_pose(4, 5)
    scene.transform = similarity((0, 0.02, 0), scale=1.1)
    renderer.render(eyes())
    assert renderer.stats.posed == 1


@pytest.mark.gl
def test_light_stays_in_the_world_where_a_scene_turns(renderer_of: Make) -> None:
    person, light = default_avatar(), random_light(3)
    view = Camera(look_at((0.2, 1.0, 2.8), (0.1, 0.8, 0)), pinhole(64, 64), 64, 64)
    place = similarity((0.1, 0, 0), rotation=(0, 0.5, 0, 0.85), scale=0.9)
    image = renderer_of(Scene([Item(person)], light=light, transform=place)).render([view])
    expected = renderer_of(Scene([Item(person, transform=place)], light=light)).render([view])
    unturned = renderer_of(Scene([Item(person, transform=place)], light=light.turned(place[:3, :3] / 0.9))).render(
        [view]
    )
    assert Difference.of(image, expected).psnr >= 60 > 45 > Difference.of(image, unturned).psnr


def test_a_viewing_point_follows_the_scenes_place() -> None:
    scene = Scene([Item(cloud(300))])
    eye, target = viewing_point(scene, 65)
    scene.transform = similarity((5, 1, -2), scale=3)
    placed_eye, placed_target = viewing_point(scene, 65)
    assert np.allclose(placed_target, 3 * target + (5, 1, -2))
    assert np.allclose(placed_eye - placed_target, 3 * (eye - target))


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


@pytest.mark.gl
def test_a_person_in_two_parts_looks_like_one(renderer_of: Make) -> None:
    person, pose = limb(400), random_pose(4, 5)
    joint = person.skeleton.names[2]
    parts = Scene([Item(person.without(joint), pose=pose), Item(person.only(joint), pose=pose)])
    whole = renderer_of(Scene([Item(person, pose=pose)])).render([camera()])
    assert np.abs(renderer_of(parts).render([camera()]) - whole).max() < 1e-5


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


SIZE = 64


def near(place: tuple[float, float, float]) -> Camera:
    at = np.array(place)
    return Camera(look_at(at + (0.3, 0.2, 2.0), at), pinhole(SIZE, SIZE, 50), SIZE, SIZE)


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["splats", "avatar", "mesh", "mesh and splats"])
@pytest.mark.parametrize("metres", [4e3, 9e5])
def test_things_far_apart_look_as_they_do_alone(renderer_of: Make, kind: str, metres: float) -> None:
    makes: dict[str, list[Any]] = {
        "splats": [cloud(300), cloud(200, seed=4)],
        "avatar": [limb(300, seed=1), limb(200, seed=2)],
        "mesh": [limb_mesh(), limb_mesh()],
        "mesh and splats": [limb_mesh(), cloud(300)],
    }
    places = [(0.0, 0.0, 0.0), (metres, 0.0, metres / 3)]
    items = [Item(thing, transform=similarity(place)) for thing, place in zip(makes[kind], places, strict=True)]
    config: dict[str, Any] = {"output": "float32", "mesh_samples": 1}  # else beside splats meshes have other edges
    together = renderer_of(Scene(items), **config)
    for turn in (0, 1, 0):
        alone = renderer_of(items[turn], **config).render([near(places[turn])])
        picture = together.render([near(places[turn])])
        assert alone[..., 3].max() > 0.5
        apart = np.abs(picture - alone).max(axis=-1) > 2e-3
        assert apart.mean() < (2e-3 if "mesh" in kind else 1e-9), (kind, turn)  # an edge may go through a sample


@pytest.mark.gl
@pytest.mark.parametrize("target", ["8", "16f"])
def test_depths_do_not_depend_on_the_precision_of_alpha(renderer_of: Make, target: str) -> None:
    view = camera(SIZE)
    exact = renderer_of(cloud(300), output="float32", target="32f").render([view], depth=True)[1]
    coarse = renderer_of(cloud(300), target=target).render([view], depth=True)[1]
    assert exact.any() and np.array_equal(coarse, exact)


@pytest.mark.gl
def test_a_pose_of_another_skeleton_is_refused_also_of_a_mesh(renderer_of: Make) -> None:
    for thing in (limb(50), limb_mesh()):
        with pytest.raises(PoseError, match="has 7 joints"):
            renderer_of(thing).render([camera(SIZE)], Pose.zero(7))


@pytest.mark.gl
def test_a_view_shows_the_items_of_its_layers(renderer_of: Make) -> None:
    mine, view = Item(cloud(50)), camera(SIZE)
    renderer = renderer_of(Scene([mine]))
    for item, seen, drawn in (
        (1, 1, True),
        (1, 2, False),
        (6, 2, True),
        (-5, 4, False),
        (~4, 1 << 99, True),
        (0, -1, 0),
    ):
        mine.layers = item
        assert renderer.render([replace(view, layers=seen)]).any() == drawn
    for wrong in (1.0, True, "all", None, [1]):
        with pytest.raises(GlsplatError, match="layers needs a whole number"):
            replace(view, layers=wrong)
        with pytest.raises(GlsplatError, match="layers needs a whole number"):
            mine.layers = wrong  # type: ignore[assignment]
    with pytest.raises(GlsplatError, match="the views of one call need the same layers"):
        renderer.render([view, replace(view, layers=2)])


@pytest.mark.gl
@pytest.mark.parametrize("pose", ["pose", np.zeros((4, 3)), {"root_pose": [0, 0, 0]}])
def test_what_is_no_pose_is_refused_with_and_without_a_skeleton(renderer_of: Make, pose: Any) -> None:
    for thing in (cloud(50), limb_mesh(), Scene()):
        renderer = renderer_of(thing)
        for call in (renderer.render, renderer.draw):
            with pytest.raises(PoseError, match="render needs a Pose"):
                call([camera(SIZE)], pose)


@pytest.mark.gl
@pytest.mark.parametrize("more", [{"out": "out"}, {"out": np.zeros((1, SIZE, SIZE, 4))}, {"depth": "no"}, {"depth": 1}])
def test_other_arguments_of_render(renderer_of: Make, more: dict[str, Any]) -> None:
    with pytest.raises(GlsplatError, match=r"out needs a contiguous array|depth is True or False"):
        renderer_of(cloud(50)).render([camera(SIZE)], **more)


@pytest.mark.gl
def test_views_of_render(renderer_of: Make) -> None:
    renderer, view = renderer_of(cloud(50)), camera(SIZE)
    wrong = ((view, r"write render\(\[camera\]\)"), ([view, None], "holds NoneType"), ([], "at least one camera"))
    for views, message in (*wrong, ([camera(32)], "the renderer's size 64x64")):
        with pytest.raises(GlsplatError, match=message):
            renderer.render(views)  # type: ignore[arg-type]
