"""The slope of the loss against finite differences and another implementation of SSIM."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from glsplat.extras.authoring.optimize.loss import loss_of

SHARE = 0.7


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    """Return a picture and its target."""
    rng = np.random.default_rng(1)
    target = gaussian_filter(rng.normal(0.5, 1.5, (40, 52, 4)), (2, 2, 0)).clip(0, 1) * 255
    missed = gaussian_filter(rng.normal(0, 0.6, target.shape), (1.5, 1.5, 0))
    return (target / 255 + missed).clip(0, 1).astype(np.float32), target.astype(np.uint8)


def blurred(values: np.ndarray) -> np.ndarray:
    return gaussian_filter(values, (1.5, 1.5, 0), mode="constant", truncate=10 / 3)  # eleven pixels


def ssim(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    mean_x, mean_y = blurred(x), blurred(y)
    xx, yy = blurred(x * x) - mean_x**2, blurred(y * y) - mean_y**2
    xy = blurred(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    return (2 * mean_x * mean_y + c1) * (2 * xy + c2) / ((mean_x**2 + mean_y**2 + c1) * (xx + yy + c2))


@pytest.mark.parametrize(
    ("structure", "trust"),
    [(0.0, "all"), (0.03, "half"), (1.0, "all"), (0.0, "uneven")],
)
def test_the_slope_is_that_of_finite_differences(
    pair: tuple[np.ndarray, np.ndarray], structure: float, trust: str
) -> None:
    picture, target = pair
    rng = np.random.default_rng(2)
    weight = {"all": np.ones((40, 52)), "half": np.full((40, 52), 0.5), "uneven": rng.random((40, 52))}[trust]
    found = loss_of(picture, target, SHARE, structure, None if trust == "all" else weight.astype(np.float32))
    y = target / 255

    def total(x: np.ndarray) -> float:
        both = (x - y) ** 2 + (structure * (1 - ssim(x, y)) if structure else 0)
        return float((SHARE * weight[..., None] * both).sum())

    places = [(0, 0, 0), (39, 51, 3), (0, 30, 1), *zip(*(rng.integers(0, n, 40) for n in picture.shape), strict=True)]
    expected = []
    for place in places:
        step = np.zeros(picture.shape)
        step[place] = 1e-5
        expected.append((total(picture + step) - total(picture - step)) / 2e-5)
    slopes = np.array([found.slope[place] for place in places])
    assert np.linalg.norm(slopes - expected) < 1e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("structure", [0.0, 0.03])
def test_errors(pair: tuple[np.ndarray, np.ndarray], structure: float) -> None:
    picture, target = pair
    found, missed = loss_of(picture, target, SHARE, structure), picture - target / 255
    assert found.squares == pytest.approx((missed**2).mean(), rel=1e-5)
    np.testing.assert_allclose(found.error, np.abs(missed).sum(axis=2), atol=1e-5)


def test_untrusted_pixels_have_no_slope(pair: tuple[np.ndarray, np.ndarray]) -> None:
    trust = np.zeros((40, 52), np.float32)
    trust[10:20] = 1
    slope = loss_of(*pair, SHARE, 0.03, trust).slope
    assert not slope[trust == 0].any() and np.array_equal(slope[10:20], loss_of(*pair, SHARE, 0.03).slope[10:20])
