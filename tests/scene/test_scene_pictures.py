"""Several things in one frame against the float64 picture of the concatenated scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat.camera import Camera, stereo_cameras
from glsplat.config import RenderConfig, with_fields
from glsplat.gl.context import Context
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from tests.compare import Difference, assert_contract
from tests.scene.worlds import random_pose, reference_of, upright, wall
from tests.scenes import cloud, eyes, limb

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]


def third_view(size: int = 64) -> Camera:
    """From the side: a pass of its own beside a pair."""
    head = np.eye(4)
    head[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    head[:3, 3] = (3.0, 0.1, 0.3)
    return stereo_cameras(head, size=(size, size))[0]


def views_of(count: int, size: int = 64) -> list[Camera]:
    return [*eyes(size)[: min(count, 2)], *([third_view(size)] if count == 3 else [])]


def mixed_scene(degrees: tuple[int, int, int] = (0, 2, 3)) -> Scene:
    """Two skinned rods through each other and a cloud, of different degrees, influences and compensation."""
    first, second = limb(300, degree=degrees[0], seed=1), limb(250, influences=2, degree=degrees[1], seed=2)
    first = replace(first, splats=replace(first.splats, antialias=True))
    return Scene(
        [
            Item(first, pose=random_pose(4, 1), transform=similarity((-0.9, 0, 0))),
            Item(second, pose=random_pose(4, 2), transform=similarity((0, -0.8, 0.1), (0, 0, 0.6, 0.8), 0.9)),
            Item(cloud(200, degrees[2], seed=3), transform=similarity((0.2, 0.1, 0), (0.3, 0.1, -0.2, 0.9), 0.7)),
        ]
    )


@pytest.mark.parametrize("views", [1, 2, 3])
@pytest.mark.parametrize("degrees", [(0, 0, 0), (0, 2, 3), (1, 0, 0)])
def test_items_interleave_as_the_concatenated_scene(
    renderer_of: Make, views: int, degrees: tuple[int, int, int]
) -> None:
    scene, cameras = mixed_scene(degrees), views_of(views)
    expected, _ = reference_of(scene, cameras)
    assert (expected[..., 3] > 0.5).mean() > 0.05
    assert_contract(renderer_of(scene, views=2).render(cameras), expected)


@pytest.mark.parametrize(
    "settings",
    [
        {"sorter": "gpu"},
        {"layers": "geometry"},
        {"shape": "quad"},
        {"rotation": "raw"},
        {"influences": 1},
        {"antialias": False},
        {"sh_degree": 1},
        {"max_sigma": 2.0},
        {"order": "per_view"},
    ],
    ids=str,
)
def test_items_under_every_knob(renderer_of: Make, context: Context, settings: dict[str, object]) -> None:
    if settings.get("sorter") == "gpu" and not context.compute:
        pytest.skip("no OpenGL 4.3")
    scene, cameras, config = mixed_scene(), list(eyes()), with_fields(RenderConfig(), **settings)  # type: ignore[arg-type]
    expected, _ = reference_of(scene, cameras, config)
    assert_contract(renderer_of(scene, views=2, **settings).render(cameras), expected)


@pytest.mark.parametrize("views", [1, 2, 3])
def test_meshes_cut_through(renderer_of: Make, views: int) -> None:
    """Two walls that cross each other, a rod and a cloud: colours, alpha and expected depth."""
    scene, cameras = mixed_scene(), views_of(views)
    scene.add(Item(upright(0.11, 0.63, (30, 200, 90))))
    front = np.array([[-0.71, -0.42, 0.07], [0.83, -0.42, -0.09], [0.83, 0.31, -0.09], [-0.71, 0.31, 0.07]])
    scene.add(Item(wall(front, (200, 60, 20)), transform=similarity((0, 0.05, 0.02), (0, 0.1, 0, 1), 1.1)))
    image, depth = renderer_of(scene, views=2, mesh_samples=1).render(cameras, depth=True)
    expected, distance = reference_of(scene, cameras)
    # a triangle's edge may fall on the other side of a pixel centre: those few pixels, and nothing else
    flipped = np.abs(depth - distance) > 1e-3
    assert flipped.sum() <= 2 * views and (expected[..., 3] == 1).mean() > 0.05
    image, expected = np.where(flipped[..., None], 0, image), np.where(flipped[..., None], 0, expected)
    assert_contract(image, expected)


@pytest.mark.parametrize("settings", [{}, {"sorter": "gpu"}, {"layers": "geometry"}], ids=str)
def test_depth_is_the_weighted_mean(renderer_of: Make, context: Context, settings: dict[str, object]) -> None:
    if settings.get("sorter") == "gpu" and not context.compute:
        pytest.skip("no OpenGL 4.3")
    scene, cameras = mixed_scene(), views_of(3)
    image, depth = renderer_of(scene, views=2, **settings).render(cameras, depth=True)
    expected, distance = reference_of(scene, cameras)
    assert_contract(image, expected)
    seen = expected[..., 3] > 0.01
    assert depth.dtype == np.float32 and (depth[expected[..., 3] == 0] == 0).all()
    assert np.abs(depth - distance)[seen].mean() < 1e-4 and (np.abs(depth - distance)[seen] < 1e-2).mean() > 0.999


@pytest.mark.parametrize("far", [0.0, 5e4])
def test_far_from_the_origin(renderer_of: Make, far: float) -> None:
    """The same scene 50 km away: float64 on the host keeps it exact."""
    offset = np.array([far, 0, -far])
    scene = mixed_scene()
    for item in scene:
        moved = item.transform.copy()
        moved[:3, 3] += offset
        item.transform = moved
    head = np.eye(4)
    head[:3, 3] = offset + (0, 0, 3)
    cameras = list(stereo_cameras(head, 0.2, size=(64, 64)))
    expected, _ = reference_of(scene, cameras)
    image = renderer_of(scene, views=2).render(cameras)
    assert Difference.of(image, expected).psnr >= 65


@pytest.mark.parametrize("thing", [cloud(300, 2), limb(300, degree=1)], ids=["splats", "avatar"])
def test_a_scene_of_one_is_that_thing_bit_for_bit(renderer_of: Make, thing: object) -> None:
    alone = renderer_of(thing, views=2).render(eyes())
    assert np.array_equal(renderer_of(Scene([Item(thing)]), views=2).render(eyes()), alone)  # type: ignore[arg-type]
    assert np.array_equal(renderer_of(Item(thing), views=2).render(eyes()), alone)  # type: ignore[arg-type]


def test_depth_does_not_change_the_picture(renderer_of: Make) -> None:
    for output in ("uint8", "float32"):
        renderer = renderer_of(mixed_scene(), views=2, output=output)
        alone = renderer.render(eyes())
        beside, depth = renderer.render(eyes(), depth=True)
        assert np.array_equal(alone, beside) and depth.shape == beside.shape[:3]
