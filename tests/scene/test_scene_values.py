"""Item and Scene: what they accept."""

from __future__ import annotations

import numpy as np
import pytest

from glsplat.errors import GlsplatError, PoseError
from glsplat.rotations import is_rigid, quaternion_matrices, quaternion_of, rodrigues_parameters
from glsplat.scene import Item, Scene, similarity
from glsplat.skinning.pose import Pose
from tests.scenes import cloud, limb


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


def test_poses_fit_or_are_refused() -> None:
    with pytest.raises(PoseError, match="2 joints, the item 4"):
        Item(limb(5), pose=Pose.zero(2))
    with pytest.raises(PoseError, match="no pose"):
        Item(cloud(5), pose=Pose.zero(4))
    with pytest.raises(PoseError, match="is a Pose, not dict"):
        Item(limb(5)).pose = {}  # type: ignore[assignment]


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


def test_rotations(rng: np.random.Generator) -> None:
    quats = rng.normal(size=(200, 4))
    quats[:4] = np.eye(4)  # half turns about the axes among them
    quats[4] = (1e-9, 1, 0, 0)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats *= np.where(quats[:, :1] < 0, -1, 1)
    for quat, matrix in zip(quats, quaternion_matrices(quats), strict=True):
        assert np.allclose(quaternion_matrices(quaternion_of(matrix)), matrix, atol=1e-12)
        small = rodrigues_parameters(matrix)
        assert np.linalg.norm(small) <= 1 + 1e-9
        square = small @ small
        assert np.allclose(quaternion_matrices(np.array([1 - square, *(2 * small)]) / (1 + square)), matrix, atol=1e-9)
        assert np.isclose(abs(quat @ quaternion_of(matrix)), 1)
    bones = np.concatenate([quaternion_matrices(quats), np.zeros((200, 3, 1))], axis=2)
    assert is_rigid(bones) and not is_rigid(bones * 1.01) and not is_rigid(-bones)
