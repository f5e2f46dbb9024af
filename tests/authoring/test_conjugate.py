"""Sparse systems against numpy's own solution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from glsplat.authoring.conjugate import solved


@pytest.mark.parametrize("count", [1, 7, 60])
def test_columns_are_solved_as_numpy_solves_them(count: int) -> None:
    rng = np.random.default_rng(count)
    some = rng.normal(size=(count, count)) * (rng.random((count, count)) < 0.2)
    matrix = some @ some.T + np.diag(rng.uniform(0.5, 50, count))
    target = rng.normal(size=(count, 3)) * (1, 1000, 0)
    found = solved(csr_matrix(matrix), target, np.zeros((count, 3)), rtol=1e-10)
    assert np.allclose(found, np.linalg.solve(matrix, target), rtol=1e-7, atol=1e-9)


def test_what_is_solved_already_stays() -> None:
    matrix = csr_matrix(np.diag([1.0, 4.0]) + 0.5)
    answer = np.array([[2.0], [-3.0]])
    assert np.array_equal(solved(matrix, matrix @ answer, answer), answer)
