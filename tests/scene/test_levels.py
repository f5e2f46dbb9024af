"""Levels of detail: which one a view gets, that its picture is that of the level, and that nothing flickers."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import FormatError, GlsplatError
from glsplat.renderer import Renderer, gpu_scene
from glsplat.renderer.levels import Proxy, chosen
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Level, Splats
from tests.compare import Difference
from tests.scenes import cloud, limb

Make = Callable[..., Renderer]
COUNTS = (800, 300, 100)


def seen_from(distance: float, size: int = 64) -> Camera:
    return Camera(look_at((0, 0, distance), (0, 0, 0)), pinhole(size, size), size, size)


def density(thing: Splats | Avatar, distance: float) -> float:
    return Proxy.of(thing).density(seen_from(distance))


def leveled(degree: int = 0) -> Splats:
    """Three clouds that nobody could take for each other: the second one suffices from 4 m on, the third from 8."""
    fine, middle, coarse = (cloud(count, degree, seed) for seed, count in enumerate(COUNTS))
    limits = density(fine, 4), density(fine, 8)
    return replace(fine, levels=(Level(middle, limits[0]), Level(coarse, limits[1])))


def leveled_limb() -> Avatar:
    fine, coarse = limb(600), limb(150, seed=8)
    return replace(fine, levels=(Level(replace(coarse, skeleton=fine.skeleton), density(fine, 4)),))


@pytest.mark.parametrize(
    ("wanted", "level"), [(1e9, 0), (801, 0), (800, 1), (401, 1), (400, 2), (200, 3), (1, 3), (0, 3)]
)
def test_the_coarsest_that_suffices(wanted: float, level: int) -> None:
    assert chosen((800, 400, 200), wanted) == level
    assert chosen((), wanted) == 0


def test_a_level_is_kept_within_a_band() -> None:
    densities, level, history = (800.0, 400.0), 1, []
    for wanted in (400.0, 395.0, 385.0, 380.0, 395.0, 405.0, 415.0, 421.0, 405.0, 390.0):
        level = chosen(densities, wanted, level)
        history.append(level)
    assert history == [1, 1, 1, 2, 2, 2, 2, 1, 1, 1]
    assert chosen(densities, 5000.0, 2) == 0 and chosen(densities, 1.0, 0) == 2  # across both at once


@pytest.mark.gl
@pytest.mark.parametrize("degree", [0, 1])
def test_the_picture_is_that_of_the_level(renderer_of: Make, degree: int) -> None:
    scene = leveled(degree)
    levels = (scene, *(one.content for one in scene.levels))
    renderer = renderer_of(scene, level="auto")
    for distance, level in ((2.0, 0), (5.0, 1), (12.0, 2), (5.0, 1), (2.0, 0)):
        view = [seen_from(distance)]
        picture = renderer.render(view)
        assert renderer.stats.levels == (level,) and renderer.stats.splats == COUNTS[level]
        assert renderer.stats.coarsest == (level == 2)
        alone = renderer_of(replace(levels[level], levels=())).render(view)
        assert Difference.of(picture, alone).psnr > 120


@pytest.mark.gl
def test_each_thing_of_a_scene_gets_its_own(renderer_of: Make) -> None:
    thing = leveled()
    items = [Item(thing), Item(thing, transform=similarity((0.5, 0, -8))), Item(cloud(50))]
    renderer = renderer_of(Scene(items), level="auto")
    view = [seen_from(3.0)]
    picture = renderer.render(view)
    assert renderer.stats.levels == (0, 2, 0)
    coarse = thing.levels[1].content
    alone = Scene([Item(replace(thing, levels=())), Item(coarse, transform=items[1].transform), Item(cloud(50))])
    assert Difference.of(picture, renderer_of(alone).render(view)).psnr > 120
    items[1].transform = similarity((0.5, 0, -8), scale=0.5)  # half as large and as far away: coarser still
    renderer.render(view)
    assert renderer.stats.levels == (0, 2, 0)
    items[1].transform = similarity((0.5, 0, -8), scale=6.0)  # its own metres are large now
    renderer.render(view)
    assert renderer.stats.levels == (0, 0, 0)


@pytest.mark.gl
def test_levels_can_be_asked_for(renderer_of: Make) -> None:
    scene, far = leveled(), [seen_from(12.0)]
    expected = {0: 0, 1: 1, 2: 2, 9: 2}
    for asked, level in expected.items():
        renderer = renderer_of(scene, level=asked)
        renderer.render(far)
        assert renderer.stats.levels == (level,) and renderer.stats.coarsest
    exact = renderer_of(scene)
    exact.render(far)
    assert exact.stats.levels == (0,) and RenderConfig().level == 0
    renderer = renderer_of(scene, level="auto", lod_bias=1.0)  # as if it were seen from half as far
    renderer.render([seen_from(6.0)])
    assert renderer.stats.levels == (0,)
    renderer.selector.bias = -2.0
    renderer.render([seen_from(6.0)])
    assert renderer.stats.levels == (2,)


@pytest.mark.gl
def test_what_nobody_sees_keeps_its_level(renderer_of: Make) -> None:
    renderer = renderer_of(leveled(), level="auto")
    away = Camera(look_at((0, 0, 2), (0, 0, 9)), pinhole(64, 64), 64, 64)
    for distance, level in ((2.0, 0), (12.0, 2)):
        renderer.render([seen_from(distance)])
        renderer.render([away])
        assert renderer.stats.levels == (level,)


@pytest.mark.gl
def test_what_is_out_of_view_does_not_count_as_finer(renderer_of: Make) -> None:
    """A server that holds a rate would wait for it in vain."""
    thing = leveled()
    scene = Scene([Item(thing), Item(thing, transform=similarity((0, 0, 30)))])  # the second is behind the eye
    renderer = renderer_of(scene, level="auto")
    renderer.render([Camera(look_at((0, 0, 29), (0, 0, 40)), pinhole(64, 64), 64, 64)])
    assert renderer.stats.levels == (2, 0) and not renderer.stats.coarsest
    renderer.render([seen_from(12.0)])
    assert renderer.stats.levels == (2, 0) and renderer.stats.coarsest


@pytest.mark.gl
@pytest.mark.parametrize(("psnr", "culled"), [(46.0, True), (45.0, True), (44.9, False), (None, False)])
def test_hidden_splats_are_left_out_by_their_price(renderer_of: Make, psnr: float | None, culled: bool) -> None:
    cones = np.tile(np.array([0, 0, 127, 127], np.int8), (400, 1))  # seen along one axis only
    scene = replace(cloud(400), cones=cones, cones_psnr=psnr)
    renderer = renderer_of(scene, cull_hidden="auto")
    plain = renderer_of(replace(scene, cones=None))
    picture = renderer.render([seen_from(3.0)])
    assert bool(renderer.variant.cull_hidden) == culled
    assert (renderer.stats.culled["hidden"] > 0) == culled
    if not culled:
        assert np.array_equal(picture, plain.render([seen_from(3.0)])) and renderer.variant == plain.variant
    # of two things only the one that may be
    both = renderer_of(Scene([Item(scene), Item(replace(scene, cones_psnr=30.0))]), cull_hidden="auto")
    both.render([seen_from(3.0)])
    assert (both.stats.culled["hidden"] > 0) == culled
    assert both.stats.culled["hidden"] <= 400


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"densities": (10, 20)}, "densities fall"),
        ({"densities": (10, 10)}, "densities fall"),
        ({"densities": (0, -1)}, "densities fall"),
        ({"densities": (np.nan, 1)}, "densities fall"),
        ({"counts": (100, 200)}, "splats grow fewer"),
        ({"counts": (800, 100)}, "splats grow fewer"),
        ({"counts": (100, 0)}, "splats grow fewer"),
    ],
)
def test_levels_that_are_none_are_refused(change: dict[str, Any], message: str) -> None:
    densities, counts = change.get("densities", (20, 10)), change.get("counts", (300, 100))
    levels = [Level(cloud(count), limit) for count, limit in zip(counts, densities, strict=True)]
    with pytest.raises(FormatError, match=message):
        replace(cloud(800), levels=levels)


def test_levels_of_another_kind_are_refused() -> None:
    avatar = limb(100)
    for other, message in ((limb(50, joints=3), "another skeleton"), (cloud(50), "holds the same, not Splats")):
        with pytest.raises(FormatError, match=message):
            replace(avatar, levels=(Level(other, 10.0),))
    with pytest.raises(FormatError, match="belong to the avatar"):
        replace(avatar, splats=replace(avatar.splats, levels=(Level(cloud(50), 10.0),)))
    inner = replace(cloud(50), levels=(Level(cloud(10), 5.0),))
    with pytest.raises(FormatError, match="no levels of its own"):
        replace(cloud(100), levels=(Level(inner, 10.0),))
    with pytest.raises(FormatError, match="not int"):
        replace(cloud(100), levels=(3,))


def test_a_view_from_inside_leaves_its_parts_out_of_all_levels() -> None:
    avatar = leveled_limb()
    less = avatar.without("joint3")
    assert len(less.levels) == 1 and 0 < len(less.levels[0].content.splats) < len(avatar.levels[0].content.splats)
    assert len(avatar.without("joint0").levels) == 0  # nothing is left


@pytest.mark.gl
def test_a_selector_refuses_what_is_no_bias(renderer_of: Make) -> None:
    renderer = renderer_of(leveled(), level="auto")
    for value in (1e5, -1e5, np.nan, "1"):
        with pytest.raises(GlsplatError, match="bias needs"):
            renderer.selector.bias = value
    renderer.selector.bias = -8
    renderer.render([seen_from(5.0)])
    assert renderer.stats.levels == (2,)
    renderer.selector = ["left"]
    with pytest.raises(GlsplatError, match="selector needs a Selector, not list"):
        renderer.render([seen_from(2.0)])


@pytest.mark.gl
def test_the_finest_says_how_densely_it_is_seen(renderer_of: Make) -> None:
    """As where levels are measured; of one that is elsewhere, or that shows nothing, no density could be told."""
    fine = cloud(800)
    away = replace(cloud(100), means=(cloud(100).means + np.float32([0, 0, 50])).astype(np.float32))
    unseen = replace(away, opacities=np.zeros_like(away.opacities))
    for coarse in (away, unseen):
        renderer = renderer_of(replace(fine, levels=(Level(coarse, density(fine, 4)),)), level="auto")
        for distance, level in ((2.0, 0), (5.0, 1)):
            renderer.render([seen_from(distance)])
            assert renderer.stats.levels == (level,)


def test_levels_are_those_of_their_splats() -> None:
    """What somebody repaints or thins out has none: they would show the old colours from afar."""
    scene, avatar = leveled(), leveled_limb()
    assert len(replace(scene, antialias=True).levels) == 2 and len(replace(avatar, meta={"a": 1}).levels) == 1
    assert replace(scene, sh=scene.sh * 2).levels == () and scene.take([1, 2]).levels == ()
    assert replace(avatar, splats=replace(avatar.splats, sh=avatar.splats.sh * 2)).levels == ()
    assert len(replace(avatar, splats=replace(avatar.splats, antialias=True)).levels) == 1
    for thing in (scene, avatar):
        again = pickle.loads(pickle.dumps(thing))
        assert len(again.levels) == len(thing.levels) and again.levels[0].density == thing.levels[0].density
    assert replace(pickle.loads(pickle.dumps(scene)), sh=scene.sh * 2).levels == ()


def test_the_same_skeleton() -> None:
    one = limb(10).skeleton
    again = Skeleton(one.names, one.parents, one.rest + 1e-8, one.inverse_bind)
    shift = np.zeros((4, 4))
    shift[:3, 3] = 1e-3
    moved = Skeleton(one.names, one.parents, one.rest + shift)
    assert one.same(one) and one.same(again) and not one.same(moved)
    assert not one.same(Skeleton([*"abcd"], one.parents, one.rest))


@pytest.mark.gl
def test_choices_are_bounded(renderer_of: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    thing = leveled()
    items = [Item(thing, transform=similarity((x, 0, 0))) for x in (-0.3, 0, 0.3)]
    renderer = renderer_of(Scene(items), level="auto")
    for x in np.linspace(0, 1, 30):
        for item, depth in zip(items, (-30 * x, -12 * x, -5 * x), strict=True):
            item.transform = similarity((0, 0, float(depth)))
        renderer.render([seen_from(2.0)])
    assert len(renderer._staged._arenas) <= gpu_scene._MAX_ARENAS
    monkeypatch.setattr(renderer._staged._arenas, "_most", 1)
    renderer.render([seen_from(2.5)])
    assert len(renderer._staged._arenas) == 1
    items[0].visible = False
    renderer.render([seen_from(2.5)])
    assert len(renderer._staged._arenas) == 1 and len(renderer.stats.levels) == 2
