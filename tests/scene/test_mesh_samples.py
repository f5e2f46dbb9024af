"""Antialiased meshes in a frame: coverage, the ground truth's picture, splats beside them, depth, pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer import Renderer
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from tests.compare import Difference
from tests.scene.worlds import random_pose, upright, wall
from tests.scenes import cloud, eyes

pytestmark = pytest.mark.gl

Make = Callable[..., Renderer]
GREY = (0.25, 0.5, 0.75)


@pytest.fixture(autouse=True)
def sampled(context: Context) -> Iterator[None]:
    with context:
        if context.ctx.max_samples < 4:
            pytest.skip("this driver has one sample a pixel")
    yield


def limb_mesh(rings: int = 12, around: int = 16) -> RiggedMesh:
    """A tube along y on three joints, of a noisy texture, with fins that are cut out."""
    rng = np.random.default_rng(4)
    y, angle = np.meshgrid(np.linspace(-0.8, 0.8, rings), np.arange(around) * 2 * np.pi / around, indexing="ij")
    tube = np.stack([0.25 * np.cos(angle), y, 0.25 * np.sin(angle)], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    a, b = (i * around + j).ravel(), (i * around + (j + 1) % around).ravel()
    faces = np.concatenate([np.stack([a, b, a + around], 1), np.stack([b, b + around, a + around], 1)])
    texture = np.full((32, 32, 4), 255, np.uint8)
    texture[..., :3] = rng.integers(30, 255, (8, 8, 3)).repeat(4, 0).repeat(4, 1)
    spots = texture.copy()
    spots[..., 3] = 255 * (np.add.outer(np.arange(32) // 8, np.arange(32) // 8) % 2)
    fin = np.array([[-0.7, -0.6, 0.1], [0.7, -0.6, -0.1], [0.7, 0.6, -0.1], [-0.7, 0.6, 0.1]])
    first = len(tube)
    fin_faces = np.array([[0, 1, 2], [0, 2, 3]]) + first
    vertices = np.concatenate([tube, fin])
    skeleton = Skeleton.from_joints(["low", "mid", "top"], [-1, 0, 1], [[0, -0.8, 0], [0, 0, 0], [0, 0.4, 0]])
    up = np.clip(vertices[:, 1] / 0.8, -1, 1)
    weights = np.stack([np.clip(-up, 0, 1), 1 - np.abs(up), np.clip(up, 0, 1)], 1)
    joints = np.tile([0, 1, 2], (len(vertices), 1))
    uv = np.stack([angle.ravel() / np.pi, y.ravel()], 1)[faces]
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[fin_faces - first]
    parts = (
        MeshPart("tube", faces.astype(np.int32), uv, texture),
        MeshPart("fin", fin_faces.astype(np.int32), square, spots),
    )
    return RiggedMesh(vertices, skeleton, joints, weights, parts)


def head_on(size: int = 64, **more: object) -> Camera:
    return Camera(look_at((0.2, 0.3, 3), (0, 0, 0)), pinhole(size, size, 50.0), size, size, **more)  # type: ignore[arg-type]


def truth_of(context: Context, mesh: RiggedMesh, cameras: list[Camera], pose: Pose) -> NDArray[np.float32]:
    size = cameras[0].width, cameras[0].height
    with MeshTruth(mesh, size=size, supersample=1, output="float32", context=context) as renderer:
        return renderer.render(cameras, pose)


@pytest.mark.parametrize("views", [1, 2])
def test_a_mesh_alone_is_the_ground_truths_picture(renderer_of: Make, context: Context, views: int) -> None:
    mesh, pose = limb_mesh(), random_pose(3, 2)
    cameras = [replace(view, background=GREY) for view in eyes(96)[:views]]
    renderer = renderer_of(Item(mesh, pose=pose), size=(96, 96), views=2)
    assert renderer.config.debug.mesh_samples == 4  # the default
    image, truth = renderer.render(cameras), truth_of(context, mesh, cameras, pose)
    assert 0.01 < ((truth[..., 3] > 0) & (truth[..., 3] < 1)).mean()
    difference = Difference.of(image, truth)
    assert difference.psnr >= 60 and difference.beyond <= 1e-3, difference
    # what one sample leaves: the bound tells the two apart
    one = renderer_of(Item(mesh, pose=pose), size=(96, 96), views=2, mesh_samples=1).render(cameras)
    assert Difference.of(one, truth).psnr < 45 and set(np.unique(one[..., 3])) == {0, 1}
    assert (one[one[..., 3] == 0][:, :3] == np.float32(GREY)).all()


def test_coverage_is_alpha_and_colours_lie_over_the_background(renderer_of: Make) -> None:
    """A slanted edge: premultiplied colour plus what the mesh leaves of the background, for pictures of either kind."""
    corners = np.array([[-2.0, -2.0, 0], [0.3, -2.0, 0], [-0.4, 2.0, 0], [-2.0, 2.0, 0]])
    scene = Item(wall(corners, (204, 102, 51)))
    view = head_on(background=GREY)
    image = renderer_of(scene).render([view])[0]
    alpha = image[..., 3:]
    assert set(np.round(np.unique(alpha) * 4, 5)) == {0, 1, 2, 3, 4}
    expected = alpha * np.array([0.8, 0.4, 0.2]) + (1 - alpha) * GREY
    assert np.abs(image[..., :3] - expected).max() < 1.5 / 255  # samples are kept in eight bits
    bytes_ = renderer_of(scene, output="uint8").render([view])[0]
    assert np.abs(bytes_ / 255 - image).max() < 1 / 255


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("splats", [False, True])
@pytest.mark.parametrize("depth", [False, True])
def test_a_pair_equals_its_single_renders(renderer_of: Make, samples: int, splats: bool, depth: bool) -> None:
    """Bit for bit, where rows of one target for both eyes would round differently."""
    scene = Scene([Item(limb_mesh(), pose=random_pose(3, 5)), Item(upright(0.3, 0.7, (30, 200, 90)))])
    if splats:
        scene.add(Item(cloud(200, 0, seed=3), transform=similarity((0.2, 0.1, 0), scale=0.7)))
    renderer = renderer_of(scene, size=(173, 131), views=2, mesh_samples=samples)
    head = np.eye(4)
    head[:3, 3] = 0.2, 0.1, 2.4
    cameras = list(stereo_cameras(head, 0.063, 70.0, size=(173, 131)))
    pair = renderer.render(cameras, depth=depth)
    for index, view in enumerate(cameras):
        alone = renderer.render([view], depth=depth)
        for both, one in zip(pair if depth else [pair], alone if depth else [alone], strict=True):
            assert np.array_equal(both[index], one[0]) and both[index].any()


def test_depth_is_that_of_what_is_covered(renderer_of: Make) -> None:
    """Two walls, one behind the other: each pixel's depth lies between theirs, and is exact within them."""
    near = wall(np.array([[-0.5, -2.0, 1], [0.3, -2.0, 1], [-0.4, 2.0, 1], [-0.5, 2.0, 1]]), (200, 0, 0))
    far = wall(np.array([[-1.5, -0.5, -1], [1.5, -0.5, -1], [1.5, 0.7, -1], [-1.5, 0.7, -1]]), (0, 200, 0))
    view = Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(64, 64, 60.0), 64, 64)
    image, depth = renderer_of(Scene([Item(near), Item(far)])).render([view], depth=True)
    seen = image[..., 3] > 0
    assert not depth[~seen].any() and (depth[seen] > 1.9999).all() and (depth[seen] < 4.0001).all()
    mixed = seen & (np.abs(depth - 2) > 1e-3) & (np.abs(depth - 4) > 1e-3)
    assert 0 < mixed.sum() < 0.03 * seen.sum()  # both in one pixel
    green = image[..., 1] / np.maximum(image[..., :2].sum(axis=-1), 1e-6)
    assert np.abs(depth - (2 + 2 * green))[seen].max() < 0.02


def test_with_splats_silhouettes_are_at_pixel_centres(renderer_of: Make) -> None:
    """Where splats may lie behind, no background shines through a mesh's edge; edges between meshes are smooth."""
    front = wall(np.array([[-0.9, -0.9, 0.5], [0.2, -0.9, 0.5], [-0.3, 0.9, 0.5], [-0.9, 0.9, 0.5]]), (255, 0, 0))
    back = wall(np.array([[-1.2, -1.1, 0], [1.1, -1.2, 0], [1.2, 1.1, 0], [-1.1, 1.2, 0]]), (0, 255, 0))
    scene = Scene([Item(front), Item(back), Item(cloud(1, 0), transform=similarity((50, 0, 0), scale=0.01))])
    image = renderer_of(scene).render([head_on(background=GREY)])[0]
    assert set(np.unique(image[..., 3])) == {0, 1}
    covered = image[image[..., 3] == 1]
    assert np.abs(covered[:, 2]).max() < 1e-6  # nothing of the background
    blended = (covered[:, 0] > 0.1) & (covered[:, 0] < 0.9)
    assert blended.sum() > 20 and np.allclose(covered[:, :2].sum(axis=1), 1, atol=2 / 255)


@pytest.mark.parametrize("far", [3.0, 3000.0])
def test_any_range_of_depths(renderer_of: Make, far: float) -> None:
    """A wall a ten-thousandth of its distance behind another, with something near that spreads the depth buffer."""
    size = far * 0.4
    corners = np.array([[-size, -size, 0], [size, -size, 0], [size, size, 0], [-size, size, 0]])
    ahead = similarity((0, 0, -far))
    behind = similarity((0, 0, -far * 1.0001))
    near = wall(
        np.array([[-0.02, -0.02, -0.1], [0.02, -0.02, -0.1], [0.02, 0.02, -0.1], [-0.02, 0.02, -0.1]]), (0, 0, 9)
    )
    scene = Scene(
        [Item(wall(corners, (200, 0, 0)), transform=ahead), Item(wall(corners, (0, 200, 0)), transform=behind)]
    )
    scene.add(Item(near))
    view = Camera(look_at((0, 0, 0), (0, 0, -1)), pinhole(64, 64, 60.0), 64, 64, near=0.01, far=1e5)
    image = renderer_of(scene).render([view])[0]
    assert not image[..., 1].any() and (image[..., 0] > 0.5).mean() > 0.3
