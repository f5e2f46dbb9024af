from __future__ import annotations

import numpy as np
import pytest

from glsplat.tracking.config import HAND_POSITION, HAND_ROTATION, HEAD_POSITION, HEAD_ROTATION
from glsplat.tracking.filters import OneEuro, PositionFilter, RotationFilter
from glsplat.tracking.solve.quat import inverse_mul, mul, rotation_angle, yaw_quat

DT = 1 / 72


@pytest.mark.parametrize("setting", [HEAD_POSITION, HAND_POSITION])
def test_a_step_never_overshoots_and_arrives(setting: OneEuro) -> None:
    filter = PositionFilter(setting, 20.0)
    filter.update((0.0, 0.0, 0.0), DT)
    path = [filter.update((0.1, 0.0, 0.0), DT)[0] for _ in range(72)]
    assert max(path) <= 0.1 + 1e-12 and path == sorted(path)
    assert path[5] > 0.09  # a small step is there within 0.1 s
    assert path[-1] == pytest.approx(0.1, abs=1e-4)


@pytest.mark.parametrize("setting", [HEAD_ROTATION, HAND_ROTATION])
def test_a_step_of_rotation_never_overshoots(setting: OneEuro) -> None:
    filter = RotationFilter(setting, 50.0)
    filter.update(yaw_quat(0.0), DT)
    path = [rotation_angle(filter.update(yaw_quat(1.0), DT)) for _ in range(72)]
    assert max(path) <= 1 + 1e-9 and np.diff(path).min() > -1e-12 and path[-1] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("speed", [0.05, 0.11, 0.2, 1.0, 5.0])
def test_the_stated_lag_holds_at_constant_speed(speed: float) -> None:
    filter = PositionFilter(HAND_POSITION, 50.0)
    for i in range(200):
        value = filter.update((speed * i * DT, 0.0, 0.0), DT)
    behind = speed * 199 * DT - value[0]
    assert behind < speed * HAND_POSITION.lag(speed) + 1e-6
    assert behind < 0.009  # metres, whatever the speed


def test_noise_at_rest_is_damped(rng: np.random.Generator) -> None:
    filter = PositionFilter(HAND_POSITION, 50.0)
    noise = rng.normal(0, 0.001, (600, 3))
    out = np.array([filter.update(tuple(v), DT) for v in noise])[50:]
    assert out.std() < 0.75 * noise.std()
    assert np.diff(out, 3, axis=0).std() < 0.05 * np.diff(noise, 3, axis=0).std()


def test_speed_is_limited_and_zero_cutoff_passes() -> None:
    limited = PositionFilter(OneEuro(0.0, 0.0), 2.0)
    limited.update((0.0, 0.0, 0.0), 0.01)
    assert limited.update((1.0, 0.0, 0.0), 0.01) == pytest.approx((0.02, 0.0, 0.0))
    turning = RotationFilter(OneEuro(0.0, 0.0), 3.0)
    turning.update(yaw_quat(0.0), 0.01)
    assert rotation_angle(turning.update(yaw_quat(2.0), 0.01)) == pytest.approx(0.03)
    free = RotationFilter(OneEuro(0.0, 0.0), 500.0)
    free.update(yaw_quat(0.0), 0.01)
    assert rotation_angle(free.update(yaw_quat(2.0), 0.01)) == pytest.approx(2.0)


def test_the_sign_of_a_quaternion_does_not_matter() -> None:
    one, two = RotationFilter(HEAD_ROTATION, 50.0), RotationFilter(HEAD_ROTATION, 50.0)
    for i in range(60):
        q = yaw_quat(0.05 * i)
        a = one.update(q, DT)
        b = two.update(tuple(-v for v in q) if i % 2 else q, DT)
        assert abs(np.dot(a, b)) > 1 - 1e-12


def test_prediction_is_right_at_constant_speed_and_bounded() -> None:
    place, turn = PositionFilter(OneEuro(0.0, 0.0), 100.0), RotationFilter(OneEuro(0.0, 0.0), 100.0)
    for i in range(100):
        place.update((2.0 * i * DT, 0.0, 0.0), DT)
        turn.update(yaw_quat(1.0 * i * DT), DT)
    assert place.ahead(0.03, 0.1)[0] == pytest.approx(2.0 * (99 * DT + 0.03), abs=1e-3)
    assert place.ahead(0.1, 0.1)[0] == pytest.approx(2.0 * 99 * DT + 0.1, abs=1e-6)
    expected = yaw_quat(99 * DT + 0.05)
    assert rotation_angle(inverse_mul(expected, turn.ahead(0.05, 0.35))) < 1e-3
    assert rotation_angle(inverse_mul(turn.value, turn.ahead(0.1, 0.02))) == pytest.approx(0.02, abs=1e-6)
    assert mul(yaw_quat(0.0), turn.value) == turn.value


def test_a_device_that_is_found_elsewhere_is_not_drawn_beyond_it() -> None:
    """It moves there at the fastest speed that is allowed, and nothing is predicted from its leap."""
    place, turn = PositionFilter(OneEuro(0.0, 0.0), 8.0), RotationFilter(OneEuro(0.0, 0.0), 30.0)
    for i in range(60):
        there = i >= 30
        place.update((1.5 * there, 0.0, 0.0), DT)
        turn.update(yaw_quat(2.0 * there), DT)
        assert 0.0 <= place.ahead(0.036, 0.25)[0] <= 1.5 + 8.0 * DT
        assert rotation_angle(inverse_mul(yaw_quat(1.0), turn.ahead(0.036, 0.6))) <= 1.0 + 30.0 * DT
