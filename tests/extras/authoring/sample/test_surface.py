"""Splats from a mesh: their places, shapes and coverage; and the fit to pictures."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.camera import Camera, look_at, pinhole
from glsplat.config import RenderConfig
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.footprints import footprints
from glsplat.extras.authoring.geometry.raster import mesh_picture
from glsplat.extras.authoring.optimize.refine import RefineConfig, refine
from glsplat.extras.authoring.sample.surface import SamplerConfig, face_densities, make_avatar
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.skeleton import Skeleton
from glsplat.splats import SH_C0


def ball(radius=0.3, texture=None, name="ball") -> tuple[np.ndarray, MeshPart]:
    """A sphere about (0, 1, 0); u runs around the axis, v up from pole to pole."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    points, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces, np.int32)
    uv = np.stack([np.arctan2(points[:, 0], points[:, 2]) / (2 * np.pi) + 0.5, points[:, 1] / (2 * radius) + 0.5], 1)
    corner = uv[faces]
    seam = np.ptp(corner[:, :, 0], axis=1) > 0.5
    corner[seam, :, 0] = np.where(corner[seam, :, 0] < 0.5, corner[seam, :, 0] + 1, corner[seam, :, 0])
    if texture is None:
        texture = np.full((8, 8, 4), 255, np.uint8)
        texture[:4, :, :3] = (230, 40, 40)  # upper half
        texture[4:, :, :3] = (30, 60, 220)
    return points + (0, 1, 0), MeshPart(name, faces, np.clip(corner, 0, 1 - 1e-9), texture)


def rigged(*balls) -> RiggedMesh:
    """Two joints; the weight of the upper grows with height over the ball."""
    vertices = np.concatenate([points for points, _ in balls])
    first = np.cumsum([0] + [len(points) for points, _ in balls])
    parts = tuple(MeshPart(p.name, p.faces + first[i], p.uv, p.texture) for i, (_, p) in enumerate(balls))
    upper = np.clip((vertices[:, 1] - 0.7) / 0.6, 0, 1)
    skeleton = Skeleton.from_joints(("base", "top"), [-1, 0], [[0, 0.7, 0], [0, 1, 0]])
    return RiggedMesh(vertices, skeleton, np.tile([0, 1], (len(vertices), 1)), np.stack([1 - upper, upper], 1), parts)


def made(mesh, splats, seed=0, **options):
    return make_avatar(mesh, splats, seed, SamplerConfig(probe=128, **options))


@pytest.fixture(scope="module")
def avatar():
    return made(rigged(ball()), 1500, seed=3, detail_boost=0.0)


def test_splats_lie_flat_on_the_surface(avatar):
    out = avatar.splats.means.astype(np.float64) - (0, 1, 0)
    radius = np.linalg.norm(out, axis=1)
    assert len(avatar.splats) == 1500
    assert np.abs(radius - 0.3).max() < 0.004
    matrices = reference.quaternion_matrices(avatar.splats.quats)
    normal = matrices[:, :, 2]
    assert np.abs(np.einsum("ij,ij->i", normal, out / radius[:, None])).min() > 0.97
    scales = avatar.splats.scales
    assert (scales[:, 2] <= 0.31 * scales[:, :2].min(axis=1)).all() and scales.min() > 0
    assert avatar.splats.sh_degree == 0
    assert ((avatar.splats.opacities >= 0.9) & (avatar.splats.opacities < 1)).all()


def test_an_iris_gets_more_splats_than_skin():
    head, eye = ball(), ball(0.012, name="eye")
    eye[0][:] += (0.03, 0.0, 0.29)  # out of the front of the ball
    mesh = rigged(head, eye)
    skeleton = Skeleton.from_joints(("head", "left_eye_smplhf"), [-1, 0], [[0, 0.7, 0], [0.03, 1, 0.29]])
    joints = (np.arange(len(mesh.vertices)) >= len(head[0])).astype(int)[:, None]
    mesh = RiggedMesh(mesh.vertices, skeleton, joints, np.ones(joints.shape), mesh.parts)
    density = face_densities(mesh, SamplerConfig(face_boost=1.0, eye_boost=6.0))
    faces, (skin, iris) = mesh.faces, (mesh.face_parts == 0, mesh.face_parts == 1)
    ahead = mesh.vertices[faces].mean(axis=1)[:, 2] - 0.29
    assert (density[skin] == 1).all()
    assert (density[iris & (ahead > 0.008)] == 6).all() and (density[iris & (ahead < 0.004)] == 0.2).all()


def test_splats_are_well_spaced(avatar):
    """Blue noise: nearest neighbours are never close (random points: 5 % below 0.23 of the mean distance)."""
    nearest = cKDTree(avatar.splats.means).query(avatar.splats.means, k=2)[0][:, 1]
    spacing = np.sqrt(2 / np.sqrt(3) * 4 * np.pi * 0.3**2 / 1500)  # a hexagonal lattice of that density
    assert np.percentile(nearest, 5) > 0.55 * spacing
    assert nearest.mean() > 0.72 * spacing
    tangential = avatar.splats.scales[:, :2].mean(axis=1)
    assert 0.35 * spacing < np.median(tangential) < 0.75 * spacing


def test_color_and_weights_come_from_the_place(avatar):
    height = avatar.splats.means[:, 1] - 1
    rgb = avatar.splats.sh[:, 0] * SH_C0 + 0.5
    assert rgb[height > 0.05] == pytest.approx(
        np.tile(np.array([230, 40, 40]) / 255, ((height > 0.05).sum(), 1)), abs=0.01
    )
    assert rgb[height < -0.05][:, 2] == pytest.approx(220 / 255, abs=0.01)
    upper = avatar.skin.dense(2)[:, 1]
    assert upper == pytest.approx(np.clip((height + 0.3) / 0.6, 0, 1), abs=0.02)
    assert avatar.skin.influences == 4 and avatar.skin.weights.sum(axis=1) == pytest.approx(1)


def test_the_surface_is_closed_and_keeps_its_outline(avatar):
    camera = Camera(look_at((0.5, 1.4, 1.2), (0, 1, 0)), pinhole(120, 120, 30), 120, 120)
    image = reference.render(avatar.splats, [camera], config=RenderConfig(antialias=False))[0]
    target = mesh_picture(rigged(ball()), rigged(ball()).vertices, camera)
    inside = target[..., 3] > 0.999
    assert image[inside, 3].min() > 0.85 and image[inside, 3].mean() > 0.99
    assert image[..., 3].sum() == pytest.approx(target[..., 3].sum(), rel=0.06)


def test_nothing_inside_gets_splats():
    inner = np.full((4, 4, 4), 255, np.uint8)
    inner[..., 1:3] = 0
    grey = np.full((4, 4, 4), 128, np.uint8)
    avatar = made(rigged(ball(0.297, inner, "skin"), ball(0.3, grey, "cloth")), 300)
    rgb = avatar.splats.sh[:, 0] * SH_C0 + 0.5
    assert rgb == pytest.approx(128 / 255, abs=0.01)


def test_holes_in_the_texture_stay_open():
    texture = np.full((64, 4, 4), 255, np.uint8)
    texture[:32, :, 3] = 0
    avatar = made(rigged(ball(0.3, texture)), 300)
    assert avatar.splats.means[:, 1].max() < 1.01
    assert avatar.splats.means[:, 1].min() < 0.72
    with pytest.raises(FormatError, match="alpha"):
        made(rigged(ball(0.3, texture * np.array([1, 1, 1, 0], np.uint8))), 300)


def test_busy_texture_gets_more_splats():
    rng = np.random.default_rng(0)
    texture = np.full((64, 64, 4), 128, np.uint8)
    texture[:32, :, :3] = rng.integers(0, 2, (32, 64, 1)) * 255
    avatar = made(rigged(ball(0.3, texture)), 1000)
    upper = (avatar.splats.means[:, 1] > 1).sum()
    assert upper > 1.6 * (1000 - upper)


def scene(rng, n=16):
    return {
        "means": rng.normal(0, 0.3, (n, 3)),
        "log_scales": np.log(rng.uniform(0.02, 0.15, (n, 3))),  # 0.6 to 5 pixels
        "turns": np.zeros((n, 3)),
        "opacities": rng.uniform(0.1, 0.9, n),
        "rgb": rng.random((n, 3)),
    }


@pytest.mark.parametrize("antialias", [False, True])
def test_footprints_make_the_contract_picture(avatar, antialias):
    camera = Camera(look_at((0.6, 1.3, 0.8), (0, 1, 0)), pinhole(64, 48, 35), 64, 48)
    splats = avatar.splats
    rgb = np.maximum(splats.sh[:, 0].astype(np.float64) * SH_C0 + 0.5, 0)
    ours = footprints(
        splats.means.astype(np.float64),
        reference.quaternion_matrices(splats.quats),
        splats.scales.astype(np.float64),
        splats.opacities.astype(np.float64),
        camera,
        antialias=antialias,
    ).picture(rgb)
    truth = reference.render(splats, [camera], config=RenderConfig(antialias=antialias))[0]
    assert ours == pytest.approx(truth, abs=1e-6)


@pytest.mark.parametrize("antialias", [False, True])
def test_gradients_are_finite_differences(rng, antialias):
    values, rotations = scene(rng), Rotation.random(16, random_state=1).as_matrix()
    camera = Camera(look_at((0, 0, 6), (0, 0, 0)), pinhole(48, 40, 15), 48, 40)
    by_picture = rng.normal(size=(40, 48, 4))

    def draw(v):
        turned = rotations @ Rotation.from_rotvec(v["turns"]).as_matrix()
        return footprints(v["means"], turned, np.exp(v["log_scales"]), v["opacities"], camera, antialias=antialias)

    gradients = draw(values).backward(by_picture, values["rgb"], values["opacities"], np.exp(values["log_scales"]))
    for key in values:
        exact, step = getattr(gradients, key), 1e-7
        numeric = np.zeros_like(values[key])
        for at in np.ndindex(values[key].shape):
            moved = {k: v.copy() for k, v in values.items()}
            moved[key][at] += step
            high = (draw(moved).picture(moved["rgb"]) * by_picture).sum()
            moved[key][at] -= 2 * step
            numeric[at] = (high - (draw(moved).picture(moved["rgb"]) * by_picture).sum()) / (2 * step)
        limit = 0.08 if key == "means" else 1e-4  # the Jacobian counts as constant under a moving mean
        assert np.abs(exact - numeric).max() < limit * np.abs(numeric).max(), key


@pytest.mark.check
def test_fitting_comes_closer_to_the_mesh():
    mesh = rigged(ball())
    start = made(mesh, 150)
    fitted = refine(start, mesh, config=RefineConfig(steps=25, size=64))
    once, again = (refine(start, mesh, 5, RefineConfig(steps=2, size=64)) for _ in range(2))
    assert once.splats.means.tobytes() == again.splats.means.tobytes()
    errors = []
    for avatar in (start, fitted):
        total = 0.0
        for eye in ((0, 1, 1.5), (1.3, 1.5, -0.4), (-0.6, 0.4, 1.0)):
            camera = Camera(look_at(eye, (0, 1, 0)), pinhole(80, 80, 30), 80, 80)
            difference = reference.render(avatar.splats, [camera])[0] - mesh_picture(mesh, mesh.vertices, camera)
            total += float((difference**2).mean())
        errors.append(total)
    assert errors[1] < 0.7 * errors[0]
    assert fitted.skin is start.skin and len(fitted.splats) == len(start.splats)


def test_too_few_splats():
    with pytest.raises(FormatError, match="at least 100"):
        made(rigged(ball()), 99)


def test_needles_keep_their_width() -> None:
    """1e11:1 in the plane of the picture: the determinant by a c - b^2 is 0 or negative here, in float64 too."""
    count = 200
    angles = np.linspace(0, np.pi, count)
    quats = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], -1)
    camera = Camera(look_at((0, 0, 3), (0, 0, 0)), np.array([[1000.0, 0, 500], [0, 1000, 500], [0, 0, 1]]), 1000, 1000)
    scales = np.tile([1e6, 1e-5, 1e-5], (count, 1))
    faint = np.full(count, 1e-9)  # nothing is drawn, only projected
    prints = footprints(np.zeros((count, 3)), reference.quaternion_matrices(quats), scales, faint, camera)
    a, _, c = prints.conic.T
    np.testing.assert_allclose(1 / (a + c), 0.3 + (1000 / 3 * 1e-5) ** 2, rtol=1e-6)  # the smaller variance, px^2
