"""Sparse symmetric systems of surfaces, solved for several columns at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

__all__ = ["solved"]

F64 = NDArray[np.float64]


def solved(matrix: csr_matrix, target: F64, start: F64, rtol: float = 1e-4, most: int = 300) -> F64:
    """[V, C] x, about ``start``, of which ``matrix`` [V, V] makes ``target`` [V, C] but for ``rtol`` of its length.

    ``matrix`` is symmetric and positive definite. Conjugate gradients with its diagonal as preconditioner, at most
    ``most`` rounds (Golub and Van Loan, Matrix Computations, 11.5). The same bytes with any number of threads, and
    none are kept busy: products of vectors are not BLAS's.
    """
    scale = 1 / matrix.diagonal()[:, None]
    x, rest = start.copy(), target - matrix @ start
    enough = rtol * np.sqrt(_dots(target, target))
    eased = scale * rest
    along, size = eased, _dots(rest, eased)
    for _ in range(most):
        if (np.sqrt(_dots(rest, rest)) <= enough).all():
            break
        moved = matrix @ along
        step = size / np.maximum(_dots(along, moved), 1e-300)
        x += step * along
        rest -= step * moved
        eased = scale * rest
        new = _dots(rest, eased)
        along = eased + new / np.maximum(size, 1e-300) * along
        size = new
    return x


def _dots(first: F64, second: F64) -> F64:
    """[C] of columns."""
    return np.asarray(np.einsum("vc,vc->c", first, second))
