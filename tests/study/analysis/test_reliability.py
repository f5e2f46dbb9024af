"""Alpha and omega: figures of R's psych and factanal on the answers below, and what cannot be had."""

from __future__ import annotations

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
