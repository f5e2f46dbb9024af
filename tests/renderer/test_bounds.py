"""The box from the bones: it holds every pixel that splats or meshes cover, and is not much larger."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.config import RenderConfig
from glsplat.data import default_avatar
from glsplat.formats.motion_files import embedded_motions, load_motion
from glsplat.renderer import Renderer
from glsplat.renderer.bounds import Bounds, covered_pixels
from glsplat.renderer.stats import Box
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from glsplat.skinning.shapes import Shapes
from tests.scene.people import boxes
from tests.scenes import cloud, limb

Make = Callable[..., Renderer]


def expressive(influences: int, seed: int) -> Avatar:
    """A limb, some of whose splats are far larger than others, with two shapes."""
    rng, avatar = np.random.default_rng(seed), limb(120, influences=influences, seed=seed)
    scales = avatar.splats.scales * np.exp(rng.normal(0, 1, (120, 1))).astype(np.float32)
    moves, bends = rng.normal(0, 0.1, (60, 3)), rng.normal(0, 0.5, (60, 2, 3))
    splats = rng.choice(120, 60, replace=False)
    shapes = Shapes.create(["a", "b"], 120, splats=splats, targets=np.arange(60) % 2, moves=moves, bends=bends)
    return replace(avatar, splats=replace(avatar.splats, scales=scales), shapes=shapes)


AVATARS = [expressive(influences, seed) for seed, influences in enumerate((1, 2, 4, 8))]


def seen_from_anywhere(rng: np.random.Generator) -> list[Camera]:
    """A pair near or far, also within the avatar or turned away from it, narrow or wide."""
    head = np.linalg.inv(look_at(rng.normal(0, 1, 3) * rng.choice([0.1, 1, 5]), rng.normal((1, 0, 0), 0.5)))
    head = head @ np.diag([1.0, -1.0, -1.0, 1.0])
    fov, near = rng.choice([2.0, 30.0, 65.0, 120.0, 170.0]), rng.choice([1e-3, 0.01, 0.3])
    size = int(rng.integers(16, 400)), int(rng.integers(16, 400))
    pair = stereo_cameras(head, float(rng.uniform(0, 0.2)), size=size)
    K = pinhole(*size, fov)
    K[:2, 2] += rng.normal(0, 0.1, 2) * size
    return [replace(eye, K=K, near=float(near), far=float(rng.choice([3.0, 1e10]))) for eye in pair]


def pixels_of(view: Camera, splats: reference.Projected) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest x, y [2] that drawn splats reach, within the picture."""
    shown = splats.visible
    reach = splats.extents[:, None] * np.sqrt(splats.covars2d[:, [0, 2]])
    low, high = (splats.means2d + sign * reach for sign in (-1, 1))
    size = (view.width, view.height)
    return np.clip(low[shown], 0, size).min(axis=0, initial=1e9), np.clip(high[shown], 0, size).max(axis=0, initial=-1)


def holds(box: Box, low: np.ndarray, high: np.ndarray) -> bool:
    return high[0] < 0 or bool((box[:2] <= low).all() and (np.add(box[:2], box[2:]) >= high).all())


PIECES = [pytest.param(2_000, seed, marks=pytest.mark.check) for seed in range(1, 6)]  # 10,000 poses in all


@pytest.mark.parametrize(("count", "seed"), [(300, 0), *PIECES])
def test_every_covered_pixel_is_in_the_box(count: int, seed: int) -> None:
    """Against the float64 projection: any pose, scale and place, expressions, compensation, cut-offs, lenses."""
    rng = np.random.default_rng(seed)
    seen = 0
    staged: dict[tuple[int, float], Bounds] = {}
    for index in range(count):
        avatar = AVATARS[index % len(AVATARS)]
        config = RenderConfig(max_sigma=(3.33, 2.0)[index % 2], antialias=bool(index % 3))
        turns = rng.normal(0, rng.choice([0.1, 0.6, 2.0]), (4, 3))
        pose = Pose(turns, rng.normal(0, 0.3, 3), expression={"a": rng.uniform(0, 1), "b": rng.uniform(0, 1)})
        transform = similarity(rng.normal(0, 0.3, 3), scale=float(rng.choice([0.1, 1.0, 3.0])))
        bones, weights = pose.bones(avatar.skeleton), avatar.weights(pose)
        posed = reference.skin(avatar.splats, avatar.skin, bones, shapes=avatar.shapes, expression=weights)
        views = seen_from_anywhere(rng)
        if (key := (index % len(AVATARS), config.max_sigma)) not in staged:
            staged[key] = Bounds.of_splats(avatar.splats, config.max_sigma, avatar.skin, 4, avatar.shapes)
        box = covered_pixels(views, [staged[key].posed(transform, bones, weights)], config)
        for view in views:
            projected = reference.project(reference.placed(posed, transform), avatar.splats, view, config)
            low, high = pixels_of(view, projected)
            assert holds(box, low, high), (index, box, low, high)
            seen += bool(projected.visible.any())
    assert seen > count / 2


@pytest.mark.gl
@pytest.mark.parametrize("count", [12, pytest.param(300, marks=pytest.mark.check)])
def test_drawn_pixels_are_in_the_box(renderer_of: Make, count: int) -> None:
    """With the GPU sorter, pictures of the box alone equal whole ones: splats, avatars and meshes, moved."""
    rng = np.random.default_rng(count)
    items = [Item(AVATARS[2]), Item(cloud(60, spread=0.1)), Item(boxes())]
    for shown in ([items[0]], [items[1]], [items[2]], items):
        byte, exact = (
            renderer_of(Scene(shown), views=2, output=output, target="32f", sorter="gpu")
            for output in ("uint8", "float32")
        )
        smaller = 0
        for _ in range(count):
            for item in shown:
                item.transform = similarity(rng.normal(0, 0.4, 3), scale=float(rng.choice([0.3, 1.0])))
                if item is not items[1]:
                    joints = len(item.content.skeleton)  # type: ignore[union-attr]
                    item.pose = Pose(rng.normal(0, 0.5, (joints, 3)), expression={"a": float(rng.uniform(0, 1))})
            head = np.linalg.inv(look_at(rng.normal(0, 2, 3), rng.normal(0, 0.5, 3))) @ np.diag([1.0, -1.0, -1.0, 1.0])
            views = [replace(eye, background=(0.2, 0.4, 0.6)) for eye in stereo_cameras(head, size=(64, 64))]
            image, whole = byte.render(views), exact.render(views)
            assert np.abs(image - np.clip(whole, 0, 1) * 255).max() <= 0.51
            width, height = byte.stats.covered[2:]
            smaller += width * height < 64 * 64
        assert smaller > count / 4


@pytest.mark.check
@pytest.mark.gl
def test_the_box_is_not_much_larger(renderer_of: Make) -> None:
    """Than the exact one, of the embedded motions from random directions: a fifth at most."""
    rng, avatar = np.random.default_rng(7), default_avatar()
    exact = renderer_of(avatar, (512, 512), 2, output="uint8", sorter="cpu")
    bounds, config, areas = Bounds.of_splats(avatar.splats, 3.33, avatar.skin, 55, avatar.shapes), RenderConfig(), []
    for name in embedded_motions():
        motion = load_motion(name, avatar.skeleton)
        for _ in range(20):
            pose, angle = motion.at(rng.uniform(0, motion.duration)), rng.uniform(0, 2 * np.pi)
            root = pose.bones(avatar.skeleton)[0] @ np.append(avatar.skeleton.joints[0], 1)
            eye = root + rng.uniform(1.5, 4) * np.array([np.sin(angle), rng.uniform(-0.2, 0.4), np.cos(angle)])
            head = np.linalg.inv(look_at(eye, root)) @ np.diag([1.0, -1.0, -1.0, 1.0])
            views = stereo_cameras(head, size=(512, 512))
            exact.render(views, pose)
            posed = bounds.posed(np.eye(4), pose.bones(avatar.skeleton), avatar.weights(pose))
            areas.append(np.prod(covered_pixels(views, [posed], config)[2:]) / np.prod(exact.stats.covered[2:]))
    assert np.median(areas) <= 1.15
