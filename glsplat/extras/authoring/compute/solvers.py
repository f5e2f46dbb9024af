"""Solve nonlinear least squares with dense derivatives, and sparse symmetric linear systems."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_matrix

from glsplat.arrays import F64

_START_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e6
_MAX_TRIALS = 6  # dampings for one step
_MAX_ROUNDS = 300  # of conjugate gradients


def least_squares(rows: Callable[[F64, bool], tuple[F64, F64]], start: F64, steps: int, tolerance: float = 1e-4) -> F64:
    """Return the unknowns [P] that minimise the sum of squares, after at most ``steps`` steps from ``start``.

    ``rows(x, True)`` returns residuals [R] and derivatives [R, P]; ``rows(x, False)`` may leave the derivatives empty.
    Stops when a step lowers the sum by less than ``tolerance`` of it. The result is never worse than ``start``.
    """
    x, damping = start.copy(), _START_DAMPING
    for _ in range(steps):
        residual, jacobian = rows(x, True)
        cost = float(residual @ residual)
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
        scale = np.diag(normal) + 1e-12
        for _ in range(_MAX_TRIALS):
            step = np.linalg.solve(normal + np.diag(damping * scale), -slope)
            trial = rows(x + step, False)[0]
            gain = cost - float(trial @ trial)
            if gain > 0:  # false for NaN too
                x, damping = x + step, max(damping / 5, _MIN_DAMPING)
                break
            damping = min(damping * 6, _MAX_DAMPING)
        else:
            return x
        if gain < tolerance * cost:
            return x
    return x


def conjugate_gradients(matrix: csr_matrix, target: F64, start: F64, rtol: float = 1e-4) -> F64:
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
    for _ in range(_MAX_ROUNDS):
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
