"""Intervals by drawing participants again, with replacement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

__all__ = ["LEVEL", "RESAMPLES", "interval_of_mean"]

F64 = NDArray[np.float64]

RESAMPLES = 10_000
LEVEL = 0.95


def interval_of_mean(sample: F64, seed: int = 0) -> tuple[float | None, float | None]:
    """95 % bootstrap interval (BCa, Efron 1987; 10,000 resamples) of the mean of [N]; (None, None) for fewer than 2."""
    n = len(sample)
    if n < 2:
        return None, None
    if sample.min() == sample.max():
        return float(sample[0]), float(sample[0])
    mean = sample.mean()
    away = sample - mean
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))
    means = away[drawn].mean(axis=1)
    below = ((means < 0).mean() + (means <= 0).mean()) / 2
    bias = ndtri(np.clip(below, 0.5 / RESAMPLES, 1 - 0.5 / RESAMPLES))
    skew = (away**3).sum() / (6 * (away**2).sum() ** 1.5)  # of the means without one participant
    normal = bias + ndtri(np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2]))
    low, high = np.quantile(means, ndtr(bias + normal / (1 - skew * normal)))
    return float(mean + low), float(mean + high)
