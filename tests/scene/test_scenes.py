"""Items and scenes: what they accept, and what is drawn as items come, go, move and hide."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.config import RenderConfig, with_fields
from glsplat.errors import GlsplatError, PoseError
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.scene.worlds import random_pose, upright
from tests.scenes import camera, cloud, eyes, limb


@pytest.mark.parametrize(
    ("transform", "message"),
    [
        (np.eye(3), "4x4 matrix, not"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.diag([1.0, 2, 1, 1]), "one scale for all axes"),
        (np.diag([1.0, 1, -1, 1]), "no reflection"),
        (np.diag([0.0, 0, 0, 1]), "scale above"),
        (np.diag([1e7, 1e7, 1e7, 1]), "below 1e"),
        ("here", "4x4 matrix of numbers"),
    ],
)
def test_transforms(transform: object, message: str) -> None:
    with pytest.raises(GlsplatError, match=message):
        Item(cloud(3), transform=transform)  # type: ignore[arg-type]
    item = Item(cloud(3))
    with pytest.raises(GlsplatError, match=message):
        item.transform = transform  # type: ignore[assignment]
    assert np.array_equal(item.transform, np.eye(4))


def test_a_transform_is_copied_and_read_only() -> None:
    mine = similarity((1, 2, 3))
    item = Item(cloud(3), transform=mine)
    with pytest.raises(ValueError, match="read-only"):
        item.transform[0, 3] = 9
    assert item.transform is not mine


def test_similarity() -> None:
    turned = similarity((1, 2, 3), (0, 0, 2, 2), 2.0)  # 90 degrees about z
    assert np.allclose(turned @ (1, 0, 0, 1), (1, 4, 3, 1))
    for wrong in ({"rotation": (0, 0, 0, 0)}, {"scale": 0}, {"scale": np.inf}, {"translation": (1, 2)}):
        with pytest.raises(GlsplatError):
            similarity(**wrong)  # type: ignore[arg-type]


def test_scenes() -> None:
    item = Item(cloud(4), name="mist")
    scene = Scene([item])
    with pytest.raises(GlsplatError, match="already"):
        scene.add(item)
    with pytest.raises(GlsplatError, match="holds Items, not Splats"):
        scene.add(cloud(4))  # type: ignore[arg-type]
    scene.remove(item)
    with pytest.raises(GlsplatError, match="not in the scene"):
        scene.remove(item)
    with pytest.raises(GlsplatError, match="not dict"):
        Item({})  # type: ignore[arg-type]
    assert "mist" in repr(item) and len(repr(item)) < 100 and len(scene) == 0


Make = Callable[..., Renderer]


def fresh(context: Context, scene: Scene, **settings: Any) -> np.ndarray:
    """The picture of a renderer that has seen nothing before."""
    config = with_fields(RenderConfig(), output="float32", **settings)
    with Renderer(Scene(scene.items), size=(64, 64), config=config, context=context) as renderer:
        return renderer.render(eyes())


@pytest.mark.gl
def test_every_change_is_drawn_as_if_new(renderer_of: Make, context: Context) -> None:
    """A walk through all the changes there are; after each the picture is that of a fresh renderer."""
    rod, mist = Item(limb(200, degree=1)), Item(cloud(150, 2))
    scene = Scene([rod, mist])
    renderer = renderer_of(scene, views=2)
    extra = Item(cloud(1500, seed=4), transform=similarity((0, 0.3, 0)))  # more than a row of the arena
    screen = Item(upright(0.1, 0.5, (200, 30, 30)))

    def pose() -> None:
        rod.pose = random_pose(4, 3)

    def move() -> None:
        mist.transform = similarity((0.1, -0.2, 0.3), (0.1, 0.2, 0, 1), 1.3)

    def hide() -> None:
        mist.visible = False

    def show() -> None:
        mist.visible = True

    def back() -> None:
        rod.pose, mist.transform = None, similarity()

    changes: list[Callable[[], object]] = [
        pose,
        move,
        lambda: scene.add(extra),
        lambda: scene.add(screen),
        hide,
        lambda: scene.remove(rod),
        show,
        lambda: scene.remove(extra),
        lambda: setattr(screen, "visible", False),
        lambda: scene.add(rod),
        lambda: setattr(screen, "visible", True),
        lambda: scene.remove(screen),
        back,
        lambda: scene.remove(mist),
        lambda: scene.remove(rod),  # nothing left
        lambda: scene.add(mist),
    ]
    before = renderer.render(eyes())
    for change in changes:
        change()
        now = renderer.render(eyes())
        assert np.array_equal(now, fresh(context, scene))
        assert np.array_equal(now, renderer.render(eyes()))  # and again, when nothing moved
        assert not np.array_equal(now, before)
        before = now


@pytest.mark.gl
def test_only_what_moved_is_posed_again(renderer_of: Make) -> None:
    first, second, still = Item(limb(50)), Item(limb(60, seed=9)), Item(cloud(70))
    scene = Scene([first, second, still])
    renderer = renderer_of(scene, views=2)
    renderer.render(eyes())
    arena, arenas = renderer._staged.arena, renderer._staged.arenas
    assert arena.runs == 3  # one an item
    renderer.render(eyes())
    assert arena.runs == 3
    first.pose = random_pose(4, 1)
    renderer.render(eyes())
    assert arena.runs == 4
    still.transform = similarity((0.1, 0, 0))
    second.pose = random_pose(4, 2)
    renderer.render([*eyes(), camera(distance=4)])  # three views, two passes
    assert arena.runs == 6 and renderer._staged.arenas == arenas
    assert "skin" in renderer.timings
    renderer.render(eyes())
    assert "skin" not in renderer.timings and "sort" not in renderer.timings


@pytest.mark.gl
def test_sizes_in_turn_neither_pose_nor_sort_again(renderer_of: Make) -> None:
    """Three clients with a size each that ask in turn while nobody moves: each goes straight to its draw."""
    scene = Scene([Item(limb(200)), Item(cloud(100))])
    renderer = renderer_of(scene, views=2)
    sizes = (64, 48, 33)
    for round_ in range(3):
        for size in sizes:
            renderer.resize(size, size)
            renderer.render(eyes(size))
            assert ("sort" in renderer.timings) == (round_ == 0)
            assert renderer.stats.sorted == (round_ == 0)
    assert renderer._staged is not None and renderer._staged.arena.runs == 2
    # four views in two passes of one variant keep their records, too
    renderer.resize(64, 64)
    four = [*eyes(), *eyes(distance=-3.0)]
    image = renderer.render(four)
    assert np.array_equal(renderer.render(four), image) and "sort" not in renderer.timings


@pytest.mark.gl
def test_hidden_splats_in_a_scene_of_which_some_have_cones(renderer_of: Make) -> None:
    """Items without cones are drawn whole, whatever the margin."""
    bare = cloud(200)
    hiding = replace(bare, cones=np.full((200, 4), (0, 0, 127, 127), np.int8))  # seen along one axis only
    for margin in (0.0, 1.5):
        renderer = renderer_of(Scene([Item(hiding), Item(bare)]), cull_hidden=True, cull_margin=margin)
        renderer.render([camera()])
        assert renderer.stats.culled["hidden"] == 200 or margin == 0.0
        assert renderer.stats.culled["hidden"] <= 200 and renderer.stats.drawn >= 190
    with pytest.raises(GlsplatError, match="cull_hidden needs splats with visibility cones"):
        renderer_of(Scene([Item(bare), Item(bare)]), cull_hidden=True)


@pytest.mark.gl
def test_an_empty_scene(renderer_of: Make) -> None:
    for scene in (Scene(), Scene([Item(cloud(10), visible=False)]), Scene([Item(upright(0.1, 0.4, (9, 90, 9)))])):
        image, depth = renderer_of(scene, views=2).render(eyes(), depth=True)
        assert np.isfinite(image).all() and image.any() == depth.any() == (len(scene) == 1 and scene.items[0].visible)


@pytest.mark.gl
def test_a_pose_given_to_render_is_the_one_avatars(renderer_of: Make) -> None:
    rod = Item(limb(100))
    renderer = renderer_of(Scene([rod, Item(cloud(50))]), views=2)
    posed = renderer.render(eyes(), random_pose(4, 7))
    assert not np.array_equal(posed, renderer.render(eyes()))
    rod.pose = random_pose(4, 7)
    assert np.array_equal(posed, renderer.render(eyes()))
    two = renderer_of(Scene([rod, Item(limb(50, 4))]))
    with pytest.raises(PoseError, match="2 avatars"):
        two.render([camera()], random_pose(4, 7))


def test_poses_fit_or_are_refused() -> None:
    with pytest.raises(PoseError, match="2 joints, the item 4"):
        Item(limb(5), pose=Pose.zero(2))
    with pytest.raises(PoseError, match="no pose"):
        Item(cloud(5), pose=Pose.zero(4))
    with pytest.raises(PoseError, match="is a Pose, not dict"):
        Item(limb(5)).pose = {}  # type: ignore[assignment]


def test_statistics_do_not_count_padding(renderer_of: Make, context: Context) -> None:
    for sorter in ("cpu", "gpu") if context.compute else ("cpu",):
        renderer = renderer_of(Scene([Item(cloud(30)), Item(cloud(1025, seed=2))]), sorter=sorter)
        renderer.render([camera()])
        stats = renderer.stats
        assert stats.splats == 1055 == stats.drawn + sum(stats.culled.values())
