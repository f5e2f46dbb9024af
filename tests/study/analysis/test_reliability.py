"""Alpha and omega: figures of R's psych and factanal on the answers below, and what cannot be had."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glsplat.errors import FormatError
from glsplat.study.analysis.reliability import reliability

# made up; R 4.2.2: psych 2.2.9 alpha(x), factanal(x, 1, control = list(opt = list(factr = 1)))
ITEMS = np.array(
    [[5, 4, 5, 3], [3, 3, 2, 4], [6, 5, 6, 5], [2, 1, 3, 2], [4, 4, 5, 4], [7, 6, 6, 5], [3, 2, 4, 3],
     [5, 5, 4, 6], [6, 7, 5, 5], [1, 2, 2, 3], [4, 3, 4, 2], [5, 6, 6, 4], [2, 3, 1, 3], [6, 6, 7, 6]],
    float,
)  # fmt: skip


def test_as_r() -> None:
    found = reliability(ITEMS)
    assert (found.alpha, found.standardised) == pytest.approx((0.9256166056, 0.9271405286), rel=1e-9)
    assert (found.low, found.high) == pytest.approx((0.8320799, 0.9732836), rel=1e-6)
    assert found.omega == pytest.approx(0.93794626, rel=1e-5) and not found.at_bound
    assert (found.n, found.items, found.left_out) == (14, 4, 0)


@pytest.mark.shared
def test_as_psych_on_a_study(shared_data: Path) -> None:
    folder = shared_data / "stats"
    said = json.loads((folder / "synthetic_2x3_within_n24.artool_expected.json").read_text())
    items = np.genfromtxt(folder / "synthetic_2x3_within_n24.csv", delimiter=",", skip_header=1, usecols=range(3, 7))
    found = reliability(items)
    assert (found.alpha, found.standardised) == pytest.approx((said["cronbach_raw"], said["cronbach_std"]), rel=1e-8)


def test_omega_is_what_items_share(rng: np.random.Generator) -> None:
    """Many answers of known loadings; with equal loadings omega is alpha."""
    loading = np.array([0.9, 0.7, 0.5, 0.3])
    factor = rng.normal(size=(20_000, 1))
    items = factor * loading + rng.normal(size=(20_000, 4)) * np.sqrt(1 - loading**2)
    expected = loading.sum() ** 2 / (loading.sum() ** 2 + (1 - loading**2).sum())
    found = reliability(items)
    assert (
        found.omega == pytest.approx(expected, abs=0.01) and found.alpha is not None and found.alpha < expected - 0.01
    )
    even = reliability(factor * 0.7 + rng.normal(size=(20_000, 3)) * 0.7)
    assert even.omega == pytest.approx(even.alpha, abs=0.003)


def test_gaps_and_what_cannot_be_had() -> None:
    gaps = np.vstack([ITEMS, [np.nan, 1, 2, 3]])
    assert reliability(gaps).left_out == 1 and reliability(gaps).alpha == reliability(ITEMS).alpha
    assert reliability(ITEMS[:, :2]).omega is None and reliability(ITEMS[:, :2]).alpha is not None
    flat = reliability(np.column_stack([ITEMS[:, 0], np.full(14, 3.0)]))
    assert flat.alpha is None and flat.omega is None
    assert reliability(ITEMS[:, [0, 0, 1]]).at_bound  # an item twice
    for few in (ITEMS[:, :1], ITEMS[:2], np.full((5, 3), np.nan)):
        with pytest.raises(FormatError, match="two items and three complete rows"):
            reliability(few)
