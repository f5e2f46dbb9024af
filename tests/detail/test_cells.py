"""Cells of neighbours."""

from __future__ import annotations

import numpy as np

from glsplat.detail.cells import cells


def test_cells_share_the_points_evenly(rng: np.random.Generator) -> None:
    for count in (1, 7, 64, 100):
        sizes = np.bincount(cells(rng.normal(size=(100, 3)), count), minlength=count)
        assert len(sizes) == count and sizes.min() >= 1 and sizes.max() <= -(-100 // count) + 2
    apart = cells(np.array([[0.0, 0], [0.1, 0], [5, 0], [5.1, 0]]), 2)
    assert apart[0] == apart[1] != apart[2] == apart[3]
