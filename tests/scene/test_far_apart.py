"""Pictures that were wrong without a word: things far apart, depths of 8 bits, and what a call ignored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import GlsplatError, PoseError
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.scene.test_mesh_samples import limb_mesh
from tests.scenes import camera, cloud, limb

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]
SIZE = 64


def near(place: tuple[float, float, float]) -> Camera:
    at = np.array(place)
    return Camera(look_at(at + (0.3, 0.2, 2.0), at), pinhole(SIZE, SIZE, 50), SIZE, SIZE)


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


def test_depths_are_refused_where_alpha_is_too_coarse(renderer_of: Make) -> None:
    view = camera(SIZE)
    exact = renderer_of(cloud(300), output="float32", target="32f").render([view], depth=True)[1]
    half = renderer_of(cloud(300), output="float32", target="16f").render([view], depth=True)[1]
    assert np.abs(half - exact)[exact > 0].max() < 0.05
    renderer = renderer_of(cloud(300), target="8")
    with pytest.raises(GlsplatError, match="depth needs a float target"):
        renderer.render([view], depth=True)
    assert renderer.render([view]).any()


@pytest.mark.parametrize("depth", ["no", 1, None, 0.0, [True]])
def test_a_switch_is_true_or_false(renderer_of: Make, depth: Any) -> None:
    with pytest.raises(GlsplatError, match="depth is True or False"):
        renderer_of(cloud(300)).render([camera(SIZE)], depth=depth)


@pytest.mark.parametrize("pose", [5, "pose", np.zeros((4, 3)), {"root_pose": [0, 0, 0]}])
@pytest.mark.parametrize(
    "thing", [cloud(50), limb(50), limb_mesh(), Scene()], ids=["splats", "avatar", "mesh", "empty"]
)
def test_what_is_no_pose_is_refused_with_and_without_a_skeleton(renderer_of: Make, pose: Any, thing: Any) -> None:
    renderer = renderer_of(thing)
    for call in (renderer.render, renderer.draw):
        with pytest.raises(PoseError, match=r"needs a glsplat\.Pose"):
            call([camera(SIZE)], pose)


def test_a_pose_of_another_skeleton_is_refused_also_of_a_mesh(renderer_of: Make) -> None:
    for thing in (limb(50), limb_mesh()):
        with pytest.raises(PoseError, match="has 7 joints"):
            renderer_of(thing).render([camera(SIZE)], Pose.zero(7))


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


@pytest.mark.parametrize("out", [[], 5, "out", (1, 2), np.zeros(3), np.zeros((1, SIZE, SIZE, 4))])
def test_what_no_picture_goes_into_is_refused(renderer_of: Make, out: Any) -> None:
    with pytest.raises(GlsplatError, match="out needs a contiguous array"):
        renderer_of(cloud(50)).render([camera(SIZE)], out=out)
