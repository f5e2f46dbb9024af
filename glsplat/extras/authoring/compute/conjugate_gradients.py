"""Solve sparse symmetric systems for several columns at once."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from glsplat.arrays import F64


def conjugate_gradients(matrix: csr_matrix, target: F64, start: F64, rtol: float = 1e-4, max_rounds: int = 300) -> F64:
    """Return x [V, C] that solves ``matrix`` [V, V] x = ``target`` [V, C] to a residual of ``rtol`` times ``target``.

    ``matrix`` is symmetric and positive definite, ``start`` [V, C] a first guess. The method is conjugate gradients
    with a diagonal preconditioner (Golub and Van Loan, Matrix Computations, 11.5). Dot products avoid BLAS, so the
    result has the same bytes with any number of threads.
    """
    scale = 1 / matrix.diagonal()[:, None]
    x, residual = start.copy(), target - matrix @ start
    tolerance = rtol * np.sqrt(_dots(target, target))
    scaled = scale * residual
    direction, size = scaled, _dots(residual, scaled)
    for _ in range(max_rounds):
        if (np.sqrt(_dots(residual, residual)) <= tolerance).all():
            break
        product = matrix @ direction
        step = size / np.maximum(_dots(direction, product), 1e-300)
        x += step * direction
        residual -= step * product
        scaled = scale * residual
        new = _dots(residual, scaled)
        direction = scaled + new / np.maximum(size, 1e-300) * direction
        size = new
    return x


def _dots(first: F64, second: F64) -> F64:
    """Return the dot products [C] of the columns of two arrays [V, C]."""
    return np.asarray(np.einsum("vc,vc->c", first, second))
