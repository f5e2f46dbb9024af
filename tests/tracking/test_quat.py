from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from glsplat.rotations import matrix_quaternions, quaternion_vectors, rotation_matrices
from glsplat.tracking.batch import resample
from glsplat.tracking.solve import quat

vectors = st.tuples(*[st.floats(-3.0, 3.0) for _ in range(3)])


@given(vectors, vectors, vectors)
def test_products_and_rotations_agree_with_matrices(a: quat.Vec, b: quat.Vec, v: quat.Vec) -> None:
    qa, qb = quat.to_quat(a), quat.to_quat(b)
    ma, mb = rotation_matrices(a), rotation_matrices(b)
    np.testing.assert_allclose(quat.rotate(quat.mul(qa, qb), v), ma @ mb @ v, atol=1e-9)
    np.testing.assert_allclose(quat.rotate(quat.inverse_mul(qa, qb), v), ma.T @ mb @ v, atol=1e-9)
    np.testing.assert_allclose(rotation_matrices(quat.rotation_vector(qa)), ma, atol=1e-8)
    x, y, z = ma.T  # columns
    np.testing.assert_allclose(rotation_matrices(quat.rotation_vector(quat.from_axes(x, y, z))), ma, atol=1e-6)


@given(vectors, vectors)
def test_between_takes_one_direction_to_the_other(a: quat.Vec, b: quat.Vec) -> None:
    a, b = quat.unit(a), quat.unit(b)
    np.testing.assert_allclose(quat.rotate(quat.between(a, b), a), b, atol=1e-4)  # opposite within 4e-5 rad: any axis
    np.testing.assert_allclose(quat.rotate(quat.between(a, quat.scale(a, -1)), a), quat.scale(a, -1), atol=1e-7)


def test_interpolation_is_short_and_even() -> None:
    a, b = quat.yaw_quat(0.2), quat.yaw_quat(1.8)
    minus = tuple(-v for v in b)
    for t in (0.0, 0.3, 1.0):
        expected = quat.yaw_quat(0.2 + 1.6 * t)
        assert abs(np.dot(quat.slerp(a, b, t), expected)) > 1 - 1e-12
        assert abs(np.dot(quat.slerp(a, minus, t), expected)) > 1 - 1e-12
    assert abs(np.dot(quat.nlerp(a, minus, 0.5), quat.yaw_quat(1.0))) > 1 - 1e-12


def test_heading_of_pitched_heads_and_none_upside_down() -> None:
    for pitch in (-1.5, 0.0, 1.5):
        turned = quat.mul(quat.yaw_quat(0.7), quat.to_quat((pitch, 0.0, 0.0)))
        assert abs(quat.wrap(quat.swing_twist_y(turned) - 0.7)) < 1e-9
    assert quat.swing_twist_y(quat.to_quat((math.pi, 0.0, 0.0))) is None


def test_batched_conversions_at_half_turns(rng: np.random.Generator) -> None:
    vectors = rng.normal(size=(200, 3))
    vectors *= (np.linspace(0, math.pi, 200) / np.linalg.norm(vectors, axis=1))[:, None]
    matrices = rotation_matrices(vectors)
    np.testing.assert_allclose(rotation_matrices(quaternion_vectors(matrix_quaternions(matrices))), matrices, atol=1e-9)


def test_resampling_keeps_the_old_moments_and_is_smooth(rng: np.random.Generator) -> None:
    t = np.arange(61) / 60
    rotations = np.zeros((61, 2, 3))
    rotations[:, 0, 1] = 3.5 * t  # beyond half a turn
    trans = np.stack([np.sin(6 * t), t, 0 * t], 1)
    turned, moved = resample(rotations, trans, 60.0, 120.0)
    assert len(moved) == 121
    np.testing.assert_allclose(rotation_matrices(turned[::2]), rotation_matrices(rotations), atol=1e-9)
    fine = np.arange(121) / 120
    np.testing.assert_allclose(moved[:, 0], np.sin(6 * fine), atol=2e-4)
    assert np.abs(np.diff(moved[:, 0], 2)).max() < 36 / 120**2 * 1.1  # no kinks
