"""Descent: splats composed of parameters, steps of Adam, bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from glsplat.extras.authoring.optimize import descent
from glsplat.extras.authoring.optimize.kernels import GRADIENTS
from glsplat.extras.authoring.optimize.refine import Adam

COUNT = 30
FREE = (1e9, -1e9, 1e9, 1e9, -1e9, 1e9)
RATES = np.repeat((0.05, 0.04, 0.03, 0.06, 0.02), (3, 3, 3, 1, 3))
SHRINK = np.repeat((0.0, 0.2, 0.0, 0.0, 0.0), (3, 3, 3, 1, 3))
LOGIT = 9


@pytest.fixture
def values(rng: np.random.Generator) -> np.ndarray:
    out = rng.normal(0, 0.4, (COUNT, descent.COUNT)).astype(np.float32)
    out[:3, 6:9] = [[0, 0, 0], [1e-7, 0, 0], [0, 2e-6, 1e-6]]  # hardly turned
    out[:, 10:] = rng.uniform(0.3, 0.7, (COUNT, 3))
    return out


def gradients_of(rng: np.random.Generator) -> np.ndarray:
    out = rng.normal(size=(COUNT, GRADIENTS))
    out[:, 13] = np.where(np.arange(COUNT) % 3, 1.0, 0.04)  # every third is hardly in the picture
    return out


class State:
    """The state that ``descent.step`` changes."""

    parts: tuple[tuple[int, int], ...] = ((0, COUNT),)

    def __init__(self, values: np.ndarray) -> None:
        self.values = values.copy()
        self.moments, self.powers = np.zeros_like(values), np.zeros_like(values)
        self.counts, self.cells = np.zeros(COUNT, np.float32), np.linspace(0.5, 2, COUNT)

    def step(
        self, gradients: np.ndarray, bounds: descent.Bounds = FREE, decay: float = 1.0, shrink: float = 0.0
    ) -> None:
        for first, last in self.parts:
            changed = self.values, self.moments, self.powers, self.counts
            descent.step(first, last, gradients, *changed, self.cells, RATES * decay, SHRINK * shrink, bounds)


def test_splats_are_composed_of_their_parameters(rng: np.random.Generator, values: np.ndarray) -> None:
    means, logs, cells = rng.normal(size=(COUNT, 3)), rng.normal(-3, 1, (COUNT, 3)), rng.uniform(0.01, 0.1, COUNT)
    turned = Rotation.random(COUNT, rng=rng)
    placed = tuple(np.zeros((COUNT, *shape)) for shape in ((3,), (3, 3), (3,), (), (3,)))
    descent.compose(0, COUNT, values, (means, turned.as_matrix(), logs, cells), placed)
    expected = (
        means + values[:, :3] * cells[:, None],
        (turned * Rotation.from_rotvec(values[:, 6:9])).as_matrix(),
        np.exp(logs + values[:, 3:6]),
        1 / (1 + np.exp(-values[:, LOGIT].astype(np.float64))),
        values[:, 10:],
    )
    for found, truth in zip(placed, expected, strict=True):
        np.testing.assert_allclose(found, truth, rtol=1e-6, atol=1e-7)


def test_steps_are_those_of_adam(rng: np.random.Generator, values: np.ndarray) -> None:
    state = State(values)
    twin = Adam(values.astype(np.float64), 1.0)
    twin.rate = RATES  # type: ignore[assignment]
    for decay in (1.0, 0.9, 0.5, 0.2):
        gradients = gradients_of(rng)
        slope = gradients[:, [0, 1, 2, 3, 4, 5, 6, 7, 8, LOGIT, 10, 11, 12]]
        slope[:, :3] *= state.cells[:, None]
        slope[:, LOGIT] *= 1 / (1 + np.exp(twin.value[:, LOGIT]))  # gradients are by the opacity's logarithm
        twin.step(slope, gradients[:, 13] > 0.05, decay)
        state.step(gradients, decay=decay)
    np.testing.assert_allclose(state.values, twin.value, atol=2e-6)
    unseen = np.arange(COUNT) % 3 == 0
    assert np.array_equal(state.values[unseen], values[unseen]) and not state.counts[unseen].any()
    assert (np.abs(state.values - values)[~unseen] > 1e-3).mean() > 0.9


def test_decoupled_decay_shrinks_scales(rng: np.random.Generator, values: np.ndarray) -> None:
    plain, thrifty = State(values), State(values)
    gradients = gradients_of(rng)
    plain.step(gradients, decay=0.5)
    thrifty.step(gradients, decay=0.5, shrink=1.0)
    seen = np.arange(COUNT) % 3 > 0
    less = plain.values - thrifty.values
    np.testing.assert_allclose(less[seen, 3:6], 0.5 * 0.04 * 0.2, rtol=1e-3)
    assert not np.delete(less, [3, 4, 5], axis=1).any() and not less[~seen].any()


def test_bones_move_splats(rng: np.random.Generator) -> None:
    blended = rng.normal(size=(COUNT, 3, 4)).astype(np.float32)
    turned = Rotation.random(COUNT, rng=rng).as_matrix().astype(np.float32)
    means, rotations = rng.normal(size=(COUNT, 3)), Rotation.random(COUNT, rng=rng).as_matrix()
    moved, rotated = np.zeros_like(means), np.zeros_like(rotations)
    descent.pose(0, COUNT, blended, turned, means, rotations, moved, rotated)
    np.testing.assert_allclose(moved, np.einsum("nij,nj->ni", blended[:, :, :3], means) + blended[:, :, 3], rtol=1e-6)
    np.testing.assert_allclose(rotated, turned.astype(np.float64) @ rotations, atol=1e-12)
