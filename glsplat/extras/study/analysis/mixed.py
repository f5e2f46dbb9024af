"""A linear mixed model with a random intercept for each participant, fitted by REML; Kenward-Roger tests.

The model of lme4's lmer(rank ~ all factors and interactions + (1 | participant)). Covariance, degrees of freedom and
scale of F are those of Kenward and Roger (1997), "Small sample inference for fixed effects from restricted maximum
likelihood", as in pbkrtest (Halekoh and Hojsgaard 2014), which car's Anova, ARTool and emmeans use on such a model.

The fixed effects are the means of the design's cells. One participant's covariance is s2 (I + r J) with J all ones: its
powers have closed forms, so the equations need only counts and sums.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize_scalar
from scipy.special import fdtrc

from glsplat.arrays import F64
from glsplat.errors import FormatError

from .repeated import NOTHING, FTest
from .table import Effect, Table, averages, hypothesis


@dataclass(frozen=True, eq=False)
class Fit:
    """Cell means [C], their covariance [C, C] before and after Kenward and Roger's adjustment, and terms of tests."""

    means: F64
    covariance: F64
    adjusted: F64
    residual: float  # variance within a participant
    intercepts: float  # variance of the random intercepts
    pieces: tuple[F64, F64]
    information: F64  # covariance of the two variances, [2, 2]


def fit(table: Table, rows: F64) -> Fit | None:
    """Return the REML fit to rows [N]; None if only the intercepts vary. Raises FormatError for too few answers."""
    cells = int(np.prod(table.shape))
    seen = np.zeros((len(table.names), cells))  # how often each participant answered each cell
    np.add.at(seen, (table.participant, table.cell), 1)
    there = seen.any(axis=1)
    seen = seen[there]
    n = seen.sum(axis=1)
    if not (n > 1).any() or len(rows) <= cells + 1:
        raise FormatError(
            f"a mixed model needs participants with several answers and more than {cells + 1} in all; "
            f"there are {len(rows)} of {len(table.names)} participants"
        )
    y = rows - rows.mean()
    sums = np.bincount(table.cell, y, cells)
    own = np.bincount(table.participant, y, len(table.names))[there]
    whole, counts = float(y @ y), seen.sum(axis=0)
    free = len(y) - cells

    def solve(ratio: float) -> tuple[float, F64, float, F64]:
        """Return -2 log restricted likelihood + const, means, residual sum of squares, Cholesky root of s2 X'V^-1 X."""
        shrink = ratio / (1 + n * ratio)
        root = cholesky(np.diag(counts) - (seen.T * shrink) @ seen, lower=True)
        right = sums - seen.T @ (shrink * own)
        means = cho_solve((root, True), right)
        left = whole - float(shrink @ own**2) - float(right @ means)
        if left <= NOTHING * whole:
            return -np.inf, means, 0.0, root
        value = free * np.log(left) + 2 * np.log(np.diag(root)).sum() + np.log1p(n * ratio).sum()
        return float(value), means, left, root

    if solve(0.0)[2] == 0:
        return None
    tries = np.linspace(-12.0, 16.0, 29)  # log of the ratio of the variances
    heights = [solve(float(np.exp(t)))[0] for t in tries]
    best = int(np.argmin(heights))
    if best == len(tries) - 1 or not np.isfinite(heights[best]):
        return None  # only the intercepts vary
    bounds = (tries[max(best - 1, 0)], tries[best + 1])
    found = minimize_scalar(
        lambda t: solve(float(np.exp(t)))[0], bounds=bounds, method="bounded", options={"xatol": 1e-9}
    )
    ratio = float(np.exp(found.x)) if found.fun < solve(0.0)[0] else 0.0
    _, means, left, root = solve(ratio)
    variance = left / free
    covariance = variance * cho_solve((root, True), np.eye(cells))
    return _adjusted(means + rows.mean(), covariance, variance, ratio, seen)


def _adjusted(means: F64, covariance: F64, variance: float, ratio: float, seen: F64) -> Fit:
    """Return the fit with Kenward and Roger's covariance of the means (equation 3; V is linear in both variances)."""
    a, n, counts = 1 / variance, seen.sum(axis=1), np.diag(seen.sum(axis=0))
    w = 1 / (1 + n * ratio)

    def over(weights: F64) -> F64:
        """Return the sum over participants of weight times X_i' J X_i."""
        return (seen.T * weights) @ seen

    def power(k: int) -> F64:
        """Return X' (V / s2)^-k X with V / s2 = I + r J: the power scales J's direction by w^k, all others by 1."""
        return counts - over((1 - w**k) / n)

    P = (-(a**2) * over(w**2), -(a**2) * power(2))  # for the intercepts' variance, for the residual's
    Q = ((a**3 * over(n * w**3), a**3 * over(w**3)), (a**3 * over(w**3), a**3 * power(3)))
    traces = a**2 * np.array([[((n * w) ** 2).sum(), (n * w**2).sum()], [(n * w**2).sum(), (n - 1 + w**2).sum()]])
    information = np.empty((2, 2))
    for i in range(2):
        for j in range(2):
            pair = covariance @ P[i] @ covariance @ P[j]
            information[i, j] = traces[i, j] - 2 * np.trace(covariance @ Q[i][j]) + np.trace(pair)
    W = 2 * np.linalg.inv(information)
    U = sum(W[i, j] * (Q[i][j] - P[i] @ covariance @ P[j]) for i in range(2) for j in range(2))
    adjusted = covariance + 2 * covariance @ U @ covariance
    return Fit(means, covariance, adjusted, variance, variance * ratio, P, np.asarray(W, np.float64))


def test(table: Table, effect: Effect, model: Fit | None) -> FTest:
    """Return Kenward and Roger's type III F test of one effect; NaN without a model."""
    L = hypothesis(table.shape, effect)
    if model is None:
        return FTest(effect, float("nan"), len(L), float("nan"), float("nan"))
    df2, scale = _degrees(model, L)
    found = L @ model.means
    f = scale * float(found @ np.linalg.solve(L @ model.adjusted @ L.T, found)) / len(L)
    return FTest(effect, f, len(L), df2, float(fdtrc(len(L), df2, f)))


def contrasts(table: Table, effect: Effect, model: Fit, weights: F64) -> tuple[F64, F64, F64]:
    """Return estimates, standard errors and degrees of freedom [C] of contrasts [C, cells] of marginal means."""
    L = weights @ averages(table.shape, effect)
    error = np.sqrt(np.einsum("ca,ab,cb->c", L, model.adjusted, L))
    return L @ model.means, error, np.array([_degrees(model, row[None])[0] for row in L])


def _degrees(model: Fit, L: F64) -> tuple[float, float]:
    """Return the denominator's degrees of freedom and the scale of F (Kenward and Roger 1997, section 3)."""
    q = len(L)
    theta = L.T @ np.linalg.solve(L @ model.covariance @ L.T, L)
    shapes = [theta @ model.covariance @ P @ model.covariance for P in model.pieces]
    W = model.information
    a1 = sum(W[i, j] * np.trace(shapes[i]) * np.trace(shapes[j]) for i in range(2) for j in range(2))
    a2 = sum(W[i, j] * np.trace(shapes[i] @ shapes[j]) for i in range(2) for j in range(2))
    b = (a1 + 6 * a2) / (2 * q)
    g = ((q + 1) * a1 - (q + 4) * a2) / ((q + 2) * a2)
    c = 3 * q + 2 * (1 - g)
    v0, v1, v2 = 1 + g / c * b, 1 - (q - g) / c * b, 1 - (q + 2 - g) / c * b
    share = 1 - a2 / q
    # small balanced designs can give 0 / 0, which pbkrtest takes as 1
    quotient = 1.0 if abs(share) < 1e-14 and abs(v1) < 1e-14 else share / v1
    rho = quotient**2 * (0.0 if abs(v0) < 1e-10 else v0) / v2 / q
    df = 4 + (q + 2) / (q * rho - 1)
    return float(df), 1.0 if abs(df - 2) < 0.01 else float(df * share / (df - 2))
