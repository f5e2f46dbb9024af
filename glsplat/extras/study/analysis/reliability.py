"""Reliability of the items of a scale: Cronbach's alpha and McDonald's omega.

>>> reliability(items).alpha
0.838
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import fdtri

from glsplat.arrays import F64
from glsplat.errors import FormatError
from glsplat.extras.statistics.nonparametric import LEVEL

SMALLEST = 0.005
"""Lower bound of an item's unique share of variance, as in R's factanal."""


@dataclass(frozen=True)
class Reliability:
    """Reliability of ``n`` complete rows of ``items`` items; None where undefined."""

    n: int
    items: int
    left_out: int
    """Rows with a missing item."""
    alpha: float | None
    low: float | None
    high: float | None
    """95 % interval of alpha."""
    standardised: float | None
    """Alpha of items scaled to equal variance, from their mean correlation."""
    omega: float | None
    """Omega total of one factor; None for fewer than three items, which do not determine a factor."""
    at_bound: bool
    """Whether the factor explains an item completely (a Heywood case), so that omega is unreliable."""


def reliability(items: F64) -> Reliability:
    """Return the reliability of answers [N, K], NaN where missing; rows with a missing item are left out.

    Alpha: Cronbach (1951), its interval Feldt (1965), exact for normal answers. Omega: McDonald (1999), from the
    loadings of one factor fitted by maximum likelihood (Joreskog 1967, as R's factanal), in the items' own units.
    Turn reversed items back first. Raises FormatError for fewer than two items or three complete rows.
    """
    kept = items[np.isfinite(items).all(axis=1)]
    n, k = kept.shape
    if k < 2 or n < 3:
        raise FormatError(f"reliability needs two items and three complete rows or more; there are {k} and {n}")
    left_out = len(items) - n
    covariance = np.cov(kept.T)
    deviations = np.sqrt(np.diag(covariance))
    total = covariance.sum()
    if not total > 1e-12 * np.abs(covariance).sum() or not (deviations > 1e-12 * np.abs(kept).max()).all():
        return Reliability(n, k, left_out, None, None, None, None, None, False)
    alpha = k / (k - 1) * (1 - np.trace(covariance) / total)
    df = n - 1, (n - 1) * (k - 1)
    low, high = (float(1 - (1 - alpha) * fdtri(*df, share)) for share in ((1 + LEVEL) / 2, (1 - LEVEL) / 2))
    correlation = covariance / np.outer(deviations, deviations)
    mean = (correlation.sum() - k) / (k * (k - 1))
    standardised = float(k * mean / (1 + (k - 1) * mean))
    omega, at_bound = _omega(correlation, deviations) if k > 2 else (None, False)
    return Reliability(n, k, left_out, float(alpha), low, high, standardised, omega, at_bound)


def _omega(correlation: F64, deviations: F64) -> tuple[float | None, bool]:
    """Return omega of one factor, and whether an item's unique variance reached its bound."""

    def loadings(own: F64) -> tuple[F64, F64]:
        values, vectors = np.linalg.eigh(correlation / np.sqrt(np.outer(own, own)))
        return np.sqrt(own) * vectors[:, -1] * np.sqrt(max(values[-1] - 1, 0.0)), np.maximum(values[:-1], 1e-300)

    def misfit(own: F64) -> tuple[float, F64]:
        loading, rest = loadings(own)
        gradient = np.diag(np.outer(loading, loading) + np.diag(own) - correlation) / own**2
        return float((rest - np.log(rest)).sum() - len(rest)), gradient

    try:
        begin = 0.5 / np.diag(np.linalg.inv(correlation))
    except np.linalg.LinAlgError:
        return None, True
    begin = np.clip(np.where(np.isfinite(begin), begin, 0.5), SMALLEST, 1.0)
    options = {"ftol": 1e-14, "gtol": 1e-9, "maxiter": 1000}
    found = minimize(misfit, begin, jac=True, method="L-BFGS-B", bounds=[(SMALLEST, 1.0)] * len(begin), options=options)
    common = float((loadings(found.x)[0] * deviations).sum() ** 2)
    whole = common + float((found.x * deviations**2).sum())
    return common / whole, bool((found.x <= SMALLEST * (1 + 1e-6)).any())
