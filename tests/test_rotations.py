"""rotations.py against scipy, which shares no code with it, turns of a half and none included."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import factorial, lpmv

from glsplat.rotations import (
    FLIP_X,
    FLIP_Z,
    component_sums,
    lengths,
    matrix_quaternions,
    nearest_rotations,
    quaternion_matrices,
    quaternion_product,
    quaternion_vectors,
    rotation_matrices,
    sh_basis,
    sh_rotations,
    slerp,
    unit_vectors,
    vector_quaternions,
)


@pytest.fixture
def vectors(rng: np.random.Generator) -> np.ndarray:
    """[N, 3] axis-angle of at most half a turn: any, none, tiny, and half a turn about any axis."""
    axes = rng.normal(size=(500, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = rng.uniform(0, np.pi, 500)
    angles[:20], angles[20:40], angles[40:80] = 0, 1e-9, np.pi
    axes[40:43] = np.eye(3)
    return axes * angles[:, None]


def same_rotation(a: np.ndarray, b: np.ndarray) -> None:
    """Quaternions wxyz up to their sign."""
    np.testing.assert_allclose(np.abs((a * b).sum(-1)), 1, atol=1e-12)


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def test_conversions(vectors: np.ndarray) -> None:
    truth = Rotation.from_rotvec(vectors)
    np.testing.assert_allclose(rotation_matrices(vectors), truth.as_matrix(), atol=1e-14)
    same_rotation(vector_quaternions(vectors), wxyz(truth))
    same_rotation(matrix_quaternions(truth.as_matrix()), wxyz(truth))
    np.testing.assert_allclose(quaternion_matrices(wxyz(truth)), truth.as_matrix(), atol=1e-14)
    back = quaternion_vectors(vector_quaternions(vectors))
    np.testing.assert_allclose(rotation_matrices(back), truth.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(back[80:], vectors[80:], atol=1e-12)
    assert np.linalg.norm(quaternion_vectors(vector_quaternions(vectors * 3)), axis=1).max() <= np.pi + 1e-12


def test_products_and_slerp(vectors: np.ndarray, rng: np.random.Generator) -> None:
    a, b = Rotation.from_rotvec(vectors), Rotation.from_rotvec(vectors[::-1])
    same_rotation(quaternion_product(wxyz(a), wxyz(b)), wxyz(a * b))
    assert not quaternion_product(wxyz(a), np.zeros((len(vectors), 4))).any()
    one = quaternion_product(wxyz(a)[7], wxyz(b))  # one with many
    same_rotation(one, wxyz(a[7] * b))
    parts = rng.random(len(vectors))
    ours = slerp(vectors, vectors[::-1], parts)
    for i in range(80, 420):  # the ends hold half turns, where both ways are as short
        pair = Rotation.from_rotvec([vectors[i], vectors[-1 - i]])
        np.testing.assert_allclose(
            rotation_matrices(ours[i]), Slerp([0, 1], pair)(parts[i]).as_matrix(), atol=1e-10, err_msg=str(i)
        )
    np.testing.assert_allclose(slerp(vectors[80:90], vectors[90:100], 0.0), vectors[80:90], atol=1e-12)


def test_nearest_rotations(rng: np.random.Generator) -> None:
    matrices = rng.normal(size=(300, 3, 3))
    ours = nearest_rotations(matrices)
    np.testing.assert_allclose(np.linalg.det(ours), 1, atol=1e-12)
    distance = np.linalg.norm(ours - matrices, axis=(1, 2))
    for vector in rng.normal(0, 0.05, (40, 3)):  # no rotation nearby is nearer
        assert (np.linalg.norm(ours @ rotation_matrices(vector) - matrices, axis=(1, 2)) >= distance - 1e-12).all()


def test_sh_basis_is_that_of_3dgs(rng: np.random.Generator) -> None:
    """Real harmonics from associated Legendre functions with the Condon-Shortley phase, as 3DGS has them."""
    d = rng.normal(size=(200, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    polar, azimuth = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    columns = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            m = abs(order)
            norm = (2 * degree + 1) / (4 * np.pi) * factorial(degree - m) / factorial(degree + m) * (2 if m else 1)
            around = np.sin(m * azimuth) if order < 0 else np.cos(m * azimuth)
            columns.append(np.sqrt(norm) * lpmv(m, degree, np.cos(polar)) * around)
    np.testing.assert_allclose(sh_basis(d, 3), np.stack(columns, axis=1), atol=1e-12)
    for degree in range(3):
        np.testing.assert_array_equal(sh_basis(d, degree), sh_basis(d, 3)[:, : (degree + 1) ** 2])


def test_sh_rotations_turn_what_is_seen(rng: np.random.Generator) -> None:
    d = rng.normal(size=(100, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    turns = np.concatenate([Rotation.random(5, random_state=1).as_matrix(), FLIP_X[None, :3, :3], FLIP_Z[None, :3, :3]])
    coefficients = rng.normal(size=16)
    for turn, matrix in zip(turns, sh_rotations(turns, 3), strict=True):
        np.testing.assert_allclose(
            sh_basis(d, 3) @ matrix @ coefficients, sh_basis(d @ turn, 3) @ coefficients, atol=1e-12
        )
        np.testing.assert_allclose(matrix, sh_rotations(turn, 3), atol=1e-13)


class TestUnitVectors:
    def test_of_any_shape_they_are_one_long_and_point_as_before(self, rng: np.random.Generator) -> None:
        vectors = rng.normal(size=(4, 7, 3)) * 10.0 ** rng.uniform(-9, 9, (4, 7, 1))
        units = unit_vectors(vectors)
        np.testing.assert_allclose(np.sqrt((units**2).sum(-1)), 1, rtol=1e-14)
        np.testing.assert_allclose(np.cross(units, vectors) / np.abs(vectors).max(-1, keepdims=True), 0, atol=1e-14)
        assert ((units * vectors).sum(-1) > 0).all() and np.array_equal(unit_vectors(vectors[0, 0]), units[0, 0])

    def test_nothing_has_no_direction(self) -> None:
        assert not unit_vectors(np.zeros((2, 3))).any()
        np.testing.assert_allclose(unit_vectors([0.0, 1e-13, 0.0]), [0, 0.1, 0])
        np.testing.assert_allclose(unit_vectors([0.0, 1e-13, 0.0], least=1e-30), [0, 1, 0])


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(3,), (1000, 3), (40, 7, 3), (50, 4), (50, 2), (0, 3)])
def test_sums_and_lengths_are_numpys_to_the_bit(kind: type[np.floating], shape: tuple[int, ...]) -> None:
    values = (np.random.default_rng(7).normal(size=shape) * 10.0 ** np.arange(shape[-1])).astype(kind)
    if values.size > 5:
        values.ravel()[3:5] = np.inf, np.nan
    assert np.array_equal(component_sums(values), values.sum(axis=-1), equal_nan=True)
    assert np.array_equal(lengths(values), np.linalg.norm(values, axis=-1), equal_nan=True)
    assert component_sums(values).dtype == lengths(values).dtype == kind
