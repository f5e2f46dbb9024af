"""Lit pictures against the float64 reference; without light, or without a surface, the same bytes and programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.errors import GlsplatError
from glsplat.light.surface import Surface
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from glsplat.splats import Level, Splats
from tests.compare import assert_contract
from tests.light.lit import random_light, surfaced
from tests.scene.worlds import random_pose
from tests.scenes import camera, cloud, eyes, limb, one_splat
from tests.skinning.faces import expressive

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]
FACE = {"jawOpen": 0.7, "eyeBlinkLeft": 1.0, "browInnerUp": 0.1}


def near(image: np.ndarray, wanted: np.ndarray) -> None:
    assert_contract(image, wanted)
    error = 10 * np.log10(1 / ((image - wanted)[..., :3] ** 2).mean())
    assert error >= 95, error


@pytest.mark.parametrize("degree", [0, 2])
@pytest.mark.parametrize("views", [1, 2])
def test_splats_that_stand(renderer_of: Make, degree: int, views: int) -> None:
    splats, light, cameras = surfaced(cloud(120, degree)), random_light(1), eyes(64)[:views]
    image = renderer_of(Scene([Item(splats)], light=light), (64, 64), views).render(cameras)
    near(image, reference.render(splats, cameras, light=light))
    unlit = renderer_of(splats, (64, 64), views).render(cameras)
    assert np.abs(image - unlit)[..., :3].mean() > 0.005


@pytest.mark.parametrize("rotation", ["polar", "raw"])
@pytest.mark.parametrize("influences", [1, 4])
def test_an_avatar_in_a_pose_with_an_expression(renderer_of: Make, rotation: str, influences: int) -> None:
    avatar, light, view = surfaced(expressive(160, influences)), random_light(2), camera(80, 2.5)
    pose = Pose(np.full((4, 3), 0.3), (0.1, 0, 0), expression=FACE)
    image = renderer_of(Scene([Item(avatar)], light=light), (80, 80), rotation=rotation).render([view], pose)
    bones = pose.bones(avatar.skeleton)
    posed = reference.skin(avatar.splats, avatar.skin, bones, rotation, avatar.shapes, avatar.weights(pose))
    wanted, _ = reference.render_scene([(posed, avatar.splats)], [view], light=light)
    near(image, wanted)
    still = reference.skin(avatar.splats, avatar.skin, bones, rotation)
    bent = reference.shading(posed, avatar.splats, light) - reference.shading(still, avatar.splats, light)
    assert np.abs(bent).max() > 0.05  # the expression turns normals, too


def test_normals_turn_as_the_skin_does() -> None:
    avatar, light = surfaced(limb(500)), random_light(5)
    pose = random_pose(4, 3, 0.8)
    posed = reference.skin(avatar.splats, avatar.skin, pose.bones(avatar.skeleton))
    found = reference.shading(posed, avatar.splats, light)
    surface = avatar.splats.surface
    turned = np.einsum("nij,nj->ni", posed.rotations, surface.units)
    facing = np.maximum(turned @ light.sun_direction, 0)
    wanted = light.irradiance(turned) * surface.ao[:, None]
    cone = np.clip(1 + (turned @ light.sun_direction - np.sqrt(1 - surface.ao)) / reference.SOFT, 0, 1)
    wanted += (facing * cone)[:, None] * light.sun_colour / np.pi
    there = surface.normals.any(axis=1)
    assert np.abs(found[there] - wanted[there] / surface.shades[there]).max() < 1e-6
    assert (found[~there] == -1).all()


def test_a_scene_of_lit_and_unlit_things_that_stand_anywhere(renderer_of: Make) -> None:
    first, second, third = surfaced(limb(100, degree=1, seed=1), 1), cloud(60, 2, 3), surfaced(cloud(60, 0, 4), 2)
    pose, light, cameras = random_pose(4, 1), random_light(3), eyes(64)
    places = [similarity((-0.9, 0, 0)), similarity((0.2, 0.1, 0), (0.3, 0.1, -0.2, 0.9), 0.7), similarity((0, 0.4, 0))]
    items = [Item(first, pose=pose, transform=places[0]), Item(second, transform=places[1])]
    items.append(Item(third, transform=places[2]))
    image = renderer_of(Scene(items, light=light), (64, 64), 2).render(cameras)
    posed = [reference.skin(first.splats, first.skin, pose.bones(first.skeleton))]
    posed += [reference.rest(second), reference.rest(third)]
    contents = [first.splats, second, third]
    parts = [(reference.placed(p, at), one) for p, at, one in zip(posed, places, contents, strict=True)]
    near(image, reference.render_scene(parts, cameras, light=light)[0])


@pytest.mark.parametrize("scales", [(0.2, 0.1, 0.0), (0.0, 0.1, 0.2), (0.2, 0.0, 0.1), (0.1, -0.2, 0.1)])
def test_flat_and_mirrored_splats_keep_their_normal(renderer_of: Make, scales: tuple[float, float, float]) -> None:
    surface, light = Surface.of(np.array([[0.36, 0.48, 0.8]]), np.ones(1)), random_light(4)
    splats = replace(one_splat(quats=[[0.5, 0.1, 0.7, -0.2]], scales=[scales]), surface=surface)
    view = camera(48, 1.0)
    image = renderer_of(Scene([Item(splats)], light=light), (48, 48)).render([view])
    near(image, reference.render(splats, [view], light=light))
    upright = replace(splats, scales=np.full((1, 3), 0.1))
    wanted = reference.shading(reference.rest(upright), upright, light)
    assert reference.shading(reference.rest(splats), splats, light) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize("thing", [surfaced(limb(200)), surfaced(cloud(200))])
def test_off_is_the_same_bytes_and_costs_nothing(renderer_of: Make, thing: Splats | Avatar) -> None:
    bare = thing if isinstance(thing, Splats) else thing.splats
    bare = replace(bare, surface=None)
    plain = bare if isinstance(thing, Splats) else replace(thing, splats=bare)
    cameras = eyes(64)
    first, second = renderer_of(plain, (64, 64), 2), renderer_of(thing, (64, 64), 2)
    wanted = first.render(cameras).copy()
    assert (second.render(cameras) == wanted).all()
    assert not second.variant.lit and second.nbytes() == first.nbytes()
    assert second.programs_compiled == first.programs_compiled
    dark = renderer_of(Scene([Item(plain)], light=random_light(1)), (64, 64), 2)  # light, and nothing that it falls on
    assert (dark.render(cameras) == wanted).all() and not dark.variant.lit and dark.nbytes() == first.nbytes()


def test_light_may_change_between_frames_and_go(renderer_of: Make) -> None:
    avatar, view = surfaced(limb(200)), camera(64, 2.5)
    scene = Scene([Item(avatar)])
    renderer = renderer_of(scene, (64, 64))
    off = renderer.render([view]).copy()
    for light in (random_light(1), random_light(2), random_light(1)):
        scene.light = light
        fresh = renderer_of(Scene([Item(avatar)], light=light), (64, 64)).render([view])
        assert (renderer.render([view]) == fresh).all()
    scene.light = None
    assert (renderer.render([view]) == off).all()
    with pytest.raises(GlsplatError, match="a scene's light needs a Light, not str"):
        scene.light = "day"  # type: ignore[assignment]


def test_levels_are_lit_with_their_own_surface(renderer_of: Make) -> None:
    fine, coarse = surfaced(limb(200)), surfaced(limb(100), 5)
    light, view = random_light(6), camera(64, 2.5)
    both = replace(fine, levels=(Level(coarse, 10.0),))
    image = renderer_of(Scene([Item(both)], light=light), (64, 64), level=1).render([view])
    assert (image == renderer_of(Scene([Item(coarse)], light=light), (64, 64)).render([view])).all()
