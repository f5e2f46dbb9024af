"""Pictures of meshes against analytic ones, against splats at the same place, and against themselves."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from glsplat.camera import Camera, look_at, pinhole, stereo_cameras
from glsplat.errors import ContextError, GlsplatError, PoseError
from glsplat.extras.authoring.mesh_truth import MeshTruth
from glsplat.extras.formats.person import read_person
from glsplat.gl.context import Context
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.renderer import Renderer
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import Splats

pytestmark = pytest.mark.gl

F64 = NDArray[np.float64]
Make = Callable[..., MeshTruth]


@pytest.fixture
def mesh_renderer(context: Context) -> Iterator[Make]:
    """Makes mesh renderers on the shared context and releases them after the test."""
    made: list[MeshTruth] = []

    def make(mesh: RiggedMesh, size: tuple[int, int] = (96, 96), **config: Any) -> MeshTruth:
        config.setdefault("output", "float32")
        if config.get("samples", 1) > max(context.ctx.max_samples, 1):
            pytest.skip("this driver has one sample a pixel")
        made.append(MeshTruth(mesh, size=size, context=context, **config))
        return made[-1]

    with context.ctx:
        yield make
        for renderer in made:
            renderer.release()
        assert context.ctx.error == "GL_NO_ERROR"


def plain(rgba: tuple[int, int, int, int] = (255, 0, 0, 255)) -> NDArray[np.uint8]:
    return np.full((4, 4, 4), rgba, np.uint8)


def quad(low: ArrayLike, high: ArrayLike, z: float = 0.0, texture: NDArray[np.uint8] | None = None) -> tuple[Any, ...]:
    """Corners [4, 3] and a part: an upright rectangle facing +z, u to the right, v up, two triangles."""
    (x0, y0), (x1, y1) = np.asarray(low, float), np.asarray(high, float)
    vertices = np.array([[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    uv = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])[faces]
    return vertices, faces, uv, plain() if texture is None else texture


def mesh_of(*quads: tuple[Any, ...], offset: ArrayLike = (0.0, 0.0, 0.0)) -> RiggedMesh:
    """Quads on one joint, each a part of its own."""
    vertices = np.concatenate([q[0] for q in quads]) + offset
    parts = tuple(MeshPart(f"part {i}", f + 4 * i, uv, t) for i, (_, f, uv, t) in enumerate(quads))
    skeleton = Skeleton.from_joints(("root",), [-1], np.array([offset], float))
    count = len(vertices)
    return RiggedMesh(vertices, skeleton, np.zeros((count, 1), np.int64), np.ones((count, 1)), parts)


ODD = np.array([[150.0, 0, 41.3], [0, 118, 57.8], [0, 0, 1]])
"""fx != fy, off-centre: what a flipped, transposed or centred projection cannot hide behind."""


def plane_points(camera: Camera, over: int = 1) -> F64:
    """[H over, W over, 2] where the rays of a camera's (sub)pixel centres meet the plane z = 0."""
    across = (np.arange(camera.width * over) + 0.5) / over
    down = (np.arange(camera.height * over) + 0.5) / over
    pixels = np.stack([*np.meshgrid(across, down), np.ones((camera.height * over, camera.width * over))], -1)
    rays = pixels @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
    eye = camera.position
    return (eye - rays * (eye[2] / rays[..., 2:]))[..., :2]


def centroid(alpha: NDArray[np.floating]) -> F64:
    rows, columns = np.indices(alpha.shape) + 0.5
    return np.array([(columns * alpha).sum(), (rows * alpha).sum()]) / alpha.sum()


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("eye", [(0.0, 0, 2), (0.7, -0.5, 1.6)], ids=["front", "oblique"])
def test_a_textured_quad_is_where_geometry_says(
    mesh_renderer: Make, samples: int, eye: tuple[float, float, float]
) -> None:
    """Colour a function of the place on the quad: every pixel inside shows the value at its own centre."""
    ramp = (np.arange(256) + 0.5) / 256
    texture = np.zeros((256, 256, 4), np.uint8)
    texture[..., 0] = np.rint(255 * ramp)  # u
    texture[..., 1] = np.rint(255 * ramp[::-1])[:, None]  # v, up
    texture[..., 2:] = 255
    camera = Camera(look_at(eye, (0.05, 0.1, 0)), ODD, 96, 112)
    mesh = mesh_of(quad((-0.5, -0.4), (0.6, 0.7), texture=texture))
    image = mesh_renderer(mesh, (96, 112), samples=samples, supersample=2).render([camera])[0]
    uv = (plane_points(camera) - (-0.5, -0.4)) / (1.1, 1.1)
    inside = ((uv > 0.05) & (uv < 0.95)).all(axis=-1)
    assert 1500 < inside.sum() < 8000
    assert np.abs(image[..., :2][inside] - uv[inside]).max() < 2.5 / 255
    assert np.abs((image[..., :2] - uv)[inside].mean(axis=0)).max() < 0.5 / 255  # a pixel is 2 to 4 / 255
    assert (image[inside][:, 2:] == 1).all()
    outside = ((uv < -0.05) | (uv > 1.05)).any(axis=-1)
    assert not image[outside].any()


@pytest.mark.parametrize(("samples", "supersample", "worst"), [(4, 2, 0.13), (1, 8, 0.07)])
def test_edges_cover_their_share_of_a_pixel(mesh_renderer: Make, samples: int, supersample: int, worst: float) -> None:
    camera = Camera(look_at((0.4, 0.3, 1.7), (0.05, 0.1, 0)), ODD, 96, 112)
    renderer = mesh_renderer(
        mesh_of(quad((-0.31, -0.27), (0.33, 0.41))), (96, 112), samples=samples, supersample=supersample
    )
    alpha = renderer.render([camera])[0, ..., 3]
    fine = plane_points(camera, 16)
    exact = ((fine > (-0.31, -0.27)) & (fine < (0.33, 0.41))).all(axis=-1).reshape(112, 16, 96, 16).mean(axis=(1, 3))
    assert np.abs(alpha - exact).max() <= worst
    assert abs(alpha.sum() - exact.sum()) < 0.003 * exact.sum()
    assert np.abs(centroid(alpha) - centroid(exact)).max() < 0.02  # pixels


def test_quads_and_splats_fall_on_the_same_place(mesh_renderer: Make, renderer_of: Callable[..., Renderer]) -> None:
    """Small squares and round splats at the same points, both eyes, off-centre K: equal centroids, no half pixel."""
    head = np.eye(4)
    head[:3, 3] = 0.1, -0.05, 1.5
    eyes = stereo_cameras(head, 0.2, K=[ODD, ODD + [[0, 0, 9.4], [0, 0, -6.1], [0, 0, 0]]], size=(96, 112))
    for x, y in ((0.0, 0.0), (-0.12, 0.17), (0.133, -0.241)):
        splat = Splats.create([[x, y, 0]], [[1, 0, 0, 0]], [[0.02] * 3], [0.99], rgb=[[1, 0, 0]])
        square = mesh_of(quad((x - 0.04, y - 0.04), (x + 0.04, y + 0.04)))
        drawn = mesh_renderer(square, (96, 112), samples=4, supersample=4).render(eyes)
        reference = renderer_of(splat, (96, 112), 2).render(eyes)
        for eye in (0, 1):
            assert np.abs(centroid(drawn[eye, ..., 3]) - centroid(reference[eye, ..., 3])).max() < 0.04


def test_cutouts_end_at_half_alpha_without_a_fringe(mesh_renderer: Make) -> None:
    """A disc of alpha in a texture that is black where it is transparent, as hair textures are."""
    y, x = np.indices((128, 128)) - 63.5
    alpha = np.clip((40 - np.hypot(x, y)) / 8 + 0.5, 0, 1)
    texture = np.zeros((128, 128, 4), np.uint8)
    texture[alpha > 0, :3] = 250, 120, 30
    texture[..., 3] = np.rint(255 * alpha)
    camera = Camera(look_at((0.0, 0, 2), (0, 0, 0)), pinhole(96, 96, 40), 96, 96, background=(0.0, 0.2, 1.0))
    mesh = mesh_of(quad((-0.6, -0.6), (0.6, 0.6), texture=texture))
    assert mesh.parts[0].cutout
    for samples, supersample in ((4, 2), (1, 1)):
        image = mesh_renderer(mesh, samples=samples, supersample=supersample).render([camera])[0]
        covered = image[..., 3:]
        pixel = 2 * 2 * np.tan(np.radians(20)) / 96
        radius = np.sqrt(covered.sum() / np.pi) * pixel
        assert abs(radius - 40 / 128 * 1.2) < 0.3 * pixel
        some = covered[..., 0] > 0.2
        colour = (image[..., :3] - (1 - covered) * np.array(camera.background))[some] / covered[some]
        assert np.abs(colour - np.array([250, 120, 30]) / 255).max() < 6 / 255
        assert covered.max() == 1 and image[48, 48, 3] == 1 and not covered[0, 0]


def test_mip_maps_average_the_stored_values(mesh_renderer: Make) -> None:
    """A fine checker far away is the mean of the bytes, 0.5; linear light would make it 0.73."""
    texture = np.zeros((256, 256, 4), np.uint8)
    texture[::2, ::2, :3] = texture[1::2, 1::2, :3] = 255
    texture[..., 3] = 255
    camera = Camera(look_at((0.0, 0, 3), (0, 0, 0)), pinhole(48, 48, 30), 48, 48)
    image = mesh_renderer(mesh_of(quad((-0.5, -0.5), (0.5, 0.5), texture=texture)), (48, 48)).render([camera])[0]
    assert np.abs(image[20:28, 20:28, :3] - 0.5).max() < 2 / 255


def test_colours_are_stored_as_they_are(mesh_renderer: Make) -> None:
    camera = Camera(look_at((0.0, 0, 1), (0, 0, 0)), pinhole(16, 16, 40), 16, 16)
    mesh = mesh_of(quad((-9, -9), (9, 9), texture=plain((200, 100, 3, 255))))
    image = mesh_renderer(mesh, (16, 16), output="uint8").render([camera])[0]
    assert image.dtype == np.uint8 and (image == (200, 100, 3, 255)).all()


def test_both_sides_show_and_depth_decides(mesh_renderer: Make) -> None:
    """A blue sheet a millimetre in front of a red one, from 5 m, from both sides, with near at 1 cm."""
    red, blue = quad((-1, -1), (1, 1)), quad((-1, -1), (1, 1), 0.001, plain((0, 0, 255, 255)))
    for order in ((red, blue), (blue, red)):
        renderer = mesh_renderer(mesh_of(*order))
        for z, channel in ((5.0, 2), (-5.0, 0)):
            camera = Camera(look_at((0.3, 0.2, z), (0, 0, 0)), pinhole(96, 96, 15), 96, 96)
            image = renderer.render([camera])[0]
            assert (image[..., channel] == 1).all() and not image[..., 2 - channel].any()


def test_near_plane_and_behind(mesh_renderer: Make) -> None:
    renderer = mesh_renderer(mesh_of(quad((-1, -1), (1, 1))))
    behind = Camera(look_at((0, 0, 2), (0, 0, 4)), pinhole(96, 96), 96, 96, background=(0.1, 0.2, 0.3))
    assert np.allclose(renderer.render([behind])[0], (0.1, 0.2, 0.3, 0))
    through = Camera(look_at((0.9, 0, 0.02), (0, 0, 0)), pinhole(96, 96), 96, 96)
    assert 0.1 < renderer.render([through])[0, ..., 3].mean() < 0.9
    beyond = replace(through, near=3.0)
    assert not renderer.render([beyond]).any()


def test_far_from_the_origin(mesh_renderer: Make) -> None:
    low, high = (-0.3, -0.3), (0.4, 0.2)
    camera = Camera(look_at((0.4, 0.3, 1.7), (0, 0, 0)), pinhole(96, 96, 40), 96, 96)
    near = mesh_renderer(mesh_of(quad(low, high))).render([camera])
    trans = np.array([1e5, -3e4, 2e5])
    moved = replace(camera, viewmat=camera.viewmat @ np.block([[np.eye(3), -trans[:, None]], [0, 0, 0, 1]]))
    far = mesh_renderer(mesh_of(quad(low, high))).render([moved], Pose(np.zeros((1, 3)), trans))
    assert np.abs(far - near).max() <= 1 / 16 and np.abs(far - near).mean() < 1e-4  # a sample on an edge may flip


def test_each_view_has_its_background(mesh_renderer: Make) -> None:
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), pinhole(32, 32), 32, 32)
    views = [replace(camera, background=b) for b in ((1.0, 0.0, 0.0), (0.25, 0.5, 0.75), (0.0, 0.0, 0.0))]
    images = mesh_renderer(mesh_of(quad((-0.5, -0.5), (0.5, 0.5))), (32, 32)).render(views)
    assert images.shape == (3, 32, 32, 4)
    for image, view in zip(images, views, strict=True):
        assert np.allclose(image[0, 0], (*view.background, 0)) and np.allclose(image[16, 16], (1, 0, 0, 1))


def test_refusals(mesh_renderer: Make, context: Context) -> None:
    mesh = mesh_of(quad((0, 0), (1, 1)))
    renderer = mesh_renderer(mesh)
    camera = Camera(np.eye(4), pinhole(96, 96), 96, 96)
    with pytest.raises(GlsplatError, match="at least one camera"):
        renderer.render([])
    with pytest.raises(GlsplatError, match="size 96x96"):
        renderer.render([camera.resized(10, 10)])
    with pytest.raises(PoseError, match="2 joints, the item 1"):
        renderer.render([camera], Pose.zero(2))
    wrong = ({"samples": 3}, "one of 1, 4"), ({"supersample": 0}, "1 to 8"), ({"output": "x"}, "float32")
    for changes, message in wrong:
        with pytest.raises(GlsplatError, match=message):
            MeshTruth(mesh, size=(8, 8), context=context, **changes)
    for size, error in (((0, 5), GlsplatError), (5, GlsplatError), ((5, context.max_size), ContextError)):
        with pytest.raises(error, match="size needs"):
            MeshTruth(mesh, size=size, context=context)  # type: ignore[arg-type]
    with pytest.raises(GlsplatError, match="MeshTruth needs a RiggedMesh, not Splats"):
        MeshTruth(Splats.create([[0, 0, 0]], [[1, 0, 0, 0]], [[1] * 3], [1], rgb=[[1, 0, 0]]), context=context)  # type: ignore[arg-type]
    assert renderer.size == (96, 96) and not isinstance(renderer, Renderer)  # it draws no other scene
    renderer.release()
    renderer.release()


@pytest.mark.shared
def test_a_posed_person_is_the_person_posed(mesh_renderer: Make, shared_data: Path) -> None:
    """Skinned on the GPU, and the same vertices posed by numpy and drawn at rest: the same picture."""
    mesh = read_person(shared_data / "people" / "char_d_registry.npz")
    pose = Pose(np.random.default_rng(2).normal(0, 0.25, (55, 3)), np.array([0.1, 0.0, 0.2]))
    still = replace(mesh, vertices=mesh.posed(pose))
    camera = Camera(look_at((0.5, 1.2, 2.4), (0, 0.9, 0)), pinhole(160, 160, 50), 160, 160)
    posed = mesh_renderer(mesh, (160, 160)).render([camera], pose)[0]
    expected = mesh_renderer(still, (160, 160)).render([camera])[0]
    assert 0.05 < posed[..., 3].mean() < 0.5
    difference = np.abs(posed - expected)
    assert difference.mean() < 2e-4 and (difference.max(axis=-1) > 0.1).mean() < 2e-3
