"""Least squares by Levenberg and Marquardt: a few dozen unknowns, dense derivatives given by the caller."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["least_squares"]

F64 = NDArray[np.float64]

_FIRST_DAMPING = 1e-3
_DAMPINGS = 1e-9, 1e6
_TRIES = 6


def least_squares(rows: Callable[[F64, bool], tuple[F64, F64]], start: F64, steps: int, enough: float = 1e-4) -> F64:
    """The unknowns [P] that make the sum of squares small, at most ``steps`` steps from ``start``.

    ``rows(x, True)`` returns residuals [R] and derivatives [R, P]; ``rows(x, False)`` may leave the derivatives empty.
    Stops where a step gains less than ``enough`` of the sum; never returns worse than it was given.
    """
    x, damping = start.copy(), _FIRST_DAMPING
    for _ in range(steps):
        residual, jacobian = rows(x, True)
        cost = float(residual @ residual)
        normal, slope = jacobian.T @ jacobian, jacobian.T @ residual
        scale = np.diag(normal) + 1e-12
        for _ in range(_TRIES):
            step = np.linalg.solve(normal + np.diag(damping * scale), -slope)
            trial = rows(x + step, False)[0]
            gain = cost - float(trial @ trial)
            if gain > 0:  # false for NaN too
                x, damping = x + step, max(damping / 5, _DAMPINGS[0])
                break
            damping = min(damping * 6, _DAMPINGS[1])
        else:
            return x
        if gain < enough * cost:
            return x
    return x
