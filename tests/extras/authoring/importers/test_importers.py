"""Imports of LHM dumps, splats bound to a mesh, rigged glTF; and posed exports."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat import reference
from glsplat.avatar import Avatar
from glsplat.camera import Camera, look_at, pinhole
from glsplat.errors import FormatError
from glsplat.extras.authoring.geometry.posed import posed_splats
from glsplat.extras.authoring.geometry.surface_points import nearest_on
from glsplat.extras.authoring.importers.bind import bind_to_mesh
from glsplat.extras.authoring.importers.lhm_dump import load_lhm_dump
from glsplat.meshes import MeshPart, RiggedMesh
from glsplat.skinning.pose import Pose
from glsplat.skinning.skeleton import Skeleton
from glsplat.skinning.skin import Skin
from glsplat.skinning.smplx import JOINT_NAMES, PARENTS
from glsplat.splats import SH_C0, Splats

LEFT_HIP = JOINT_NAMES.index("left_hip")


def dump(rng, n=20, **changes):
    """Return splats of which the first half is bound to the left hip, turned by 20 degrees in the canonical pose."""
    joints = rng.normal(0, 0.3, (55, 3))
    turn = Rotation.from_euler("z", -20, degrees=True).as_matrix()
    transform = np.tile(np.eye(4), (55, 1, 1))
    transform[LEFT_HIP, :3, :3] = turn
    transform[LEFT_HIP, :3, 3] = joints[LEFT_HIP] - turn @ joints[LEFT_HIP]
    weights = np.zeros((n, 55))
    weights[: n // 2, LEFT_HIP], weights[n // 2 :, 0] = 1, 1
    data = {
        "query_points": rng.normal(0, 0.5, (n, 3)),
        "offset_xyz": rng.normal(0, 0.01, (n, 3)),
        "opacity": rng.uniform(0.2, 1, (n, 1)),
        "rotation_wxyz": rng.normal(size=(n, 4)),
        "scaling": rng.uniform(0.001, 0.05, (n, 3)),
        "rgb": rng.random((n, 3)),
        "skinning_weight": weights,
        "transform_mat_neutral_pose": transform,
        "betas": rng.normal(size=10),
        "shape_dirs": rng.normal(0, 0.01, (n, 3, 10)),
        "joints_zero": joints,
        "parents": PARENTS,
        "is_constrain_body": np.arange(n) % 4 == 0,
    }
    data.update(changes)
    return {key: value for key, value in data.items() if value is not None}


def test_lhm_dump(tmp_path, rng):
    data = dump(rng)
    np.savez(tmp_path / "d.npz", **data)
    avatar = load_lhm_dump(tmp_path / "d.npz")
    query = data["query_points"] + data["offset_xyz"]
    turn = data["transform_mat_neutral_pose"][LEFT_HIP, :3, :3]
    hip = data["joints_zero"][LEFT_HIP]
    wanted = np.where(np.arange(20)[:, None] < 10, (query - hip) @ turn.T + hip, query)
    wanted = wanted + data["shape_dirs"] @ data["betas"]
    shift = wanted - avatar.splats.means
    assert shift == pytest.approx(np.tile([0, shift[0, 1], 0], (20, 1)), abs=1e-6)
    assert avatar.splats.means[:, 1].min() == pytest.approx(0, abs=0.02)
    assert avatar.skeleton.joints == pytest.approx(data["joints_zero"] - shift[0], abs=1e-6)
    assert avatar.skeleton.names == JOINT_NAMES
    assert avatar.skin.dense(55) == pytest.approx(data["skinning_weight"])
    before = reference.quaternion_matrices(
        Splats.create(query, data["rotation_wxyz"], query, query[:, 0], rgb=query).quats
    )
    after = reference.quaternion_matrices(avatar.splats.quats)
    assert after[1] == pytest.approx(turn @ before[1], abs=1e-5)  # rides the hip
    assert after[4] == pytest.approx(before[4], abs=1e-5)  # constrained: never turned
    assert after[13] == pytest.approx(before[13], abs=1e-5)  # rides the pelvis
    assert avatar.splats.sh[:, 0] * SH_C0 + 0.5 == pytest.approx(data["rgb"], abs=1e-6)
    assert set(avatar.meta) == {"source", "body_model", "licence"}  # nothing that no one reads


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"betas": None}, "betas"),
        ({"rgb": np.full((20, 3), 1.5)}, "rgb"),
        ({"opacity": np.full((20, 1), -3.0)}, "opacity"),
        ({"query_points": np.full((20, 3), np.nan)}, "query_points"),
        ({"skinning_weight": np.zeros((20, 24))}, "skinning_weight"),
        ({"parents": np.arange(55)}, "root"),
        ({"rotation_wxyz": np.array([["a"] * 4] * 20)}, "numbers"),
    ],
)
def test_wrong_lhm_dumps(tmp_path, rng, changes, word):
    path = tmp_path / "d.npz"
    np.savez(path, **dump(rng, **changes))
    with pytest.raises(FormatError, match=word) as caught:
        load_lhm_dump(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    path.write_bytes(b"PK not really")
    with pytest.raises(FormatError, match=r"d\.npz"):
        load_lhm_dump(path)


def wall() -> RiggedMesh:
    """A square of one metre in z = 0; the weight of the second joint grows from left to right."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    part = MeshPart("wall", faces, vertices[faces][..., :2], np.full((4, 4, 4), 200, np.uint8))
    weights = np.stack([1 - vertices[:, 0], vertices[:, 0]], axis=1)
    skeleton = Skeleton.from_joints(("a", "b"), [-1, 0], [[0, 0, 0], [1, 0, 0]])
    return RiggedMesh(vertices, skeleton, np.tile([0, 1], (4, 1)), weights, (part,))


def test_binding_takes_the_nearest_weights(rng):
    at = np.concatenate([rng.random((50, 2)), rng.uniform(-0.04, 0.04, (50, 1))], axis=1)
    splats = Splats.create(
        at, np.tile([1, 0, 0, 0], (50, 1)), np.full((50, 3), 0.01), np.ones(50), rgb=np.ones((50, 3))
    )
    avatar = bind_to_mesh(splats, wall())
    assert avatar.skin.dense(2)[:, 1] == pytest.approx(at[:, 0], abs=1e-5)
    assert avatar.splats is splats
    with pytest.raises(FormatError, match="50 of 50 splats"):
        bind_to_mesh(Splats.create(at + 1, splats.quats, splats.scales, splats.opacities, splats.sh), wall())


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_posed_splats_look_like_the_posed_avatar(rng, degree):
    n = 25
    splats = Splats.create(
        rng.normal(0, 0.2, (n, 3)),
        rng.normal(size=(n, 4)),
        rng.uniform(0.02, 0.1, (n, 3)),
        rng.uniform(0.3, 0.9, n),
        rng.normal(0, 0.3, (n, (degree + 1) ** 2, 3)),
    )
    mix = rng.random(n)
    skin = Skin.create(np.tile([0, 1], (n, 1)), np.stack([mix, 1 - mix], axis=1), 2)
    avatar = Avatar(splats, wall().skeleton, skin)
    pose = Pose(np.array([[0.2, 0.5, 0], [0, 0, 0.9]]), np.array([0.1, 0, 0]))
    camera = Camera(look_at((0, 0.3, 2), (0.2, 0, 0)), pinhole(48, 48, 40), 48, 48)
    skinned = reference.render(splats, [camera], skin, pose.bones(avatar.skeleton))
    static = reference.render(posed_splats(avatar, pose), [camera])
    assert static == pytest.approx(skinned, abs=2e-5)


def test_no_points_have_no_nearest_ones() -> None:
    triangle, faces = np.eye(3), np.array([[0, 1, 2]])
    at, far, face, bary = nearest_on(triangle, faces, np.zeros((0, 3)))
    assert [len(one) for one in (at, far, face, bary)] == [0] * 4
    at, far, face, bary = nearest_on(triangle, faces, np.ones((1, 3)))
    assert np.allclose(at, 1 / 3) and np.allclose(far, 2 / np.sqrt(3)) and np.allclose(bary, 1 / 3) and face == [0]
