"""Solve nonlinear least squares by Levenberg-Marquardt, with a few dozen unknowns and dense derivatives."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from glsplat.arrays import F64

_START_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e6
_MAX_TRIALS = 6  # dampings for one step


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
