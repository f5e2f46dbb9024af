"""Bootstrap confidence intervals over participants."""

from __future__ import annotations

import numpy as np
from scipy.stats import bootstrap

from glsplat.arrays import F64
from glsplat.extras.statistics.ranks import TIE

RESAMPLES = 10_000
LEVEL = 0.95


def interval_of_mean(sample: F64, seed: int = 0) -> tuple[float | None, float | None]:
    """Return the 95 % bootstrap interval (BCa, Efron 1987; 10,000 resamples) of the mean of [N]; None for N < 2."""
    if len(sample) < 2:
        return None, None
    if np.ptp(sample) <= TIE * np.abs(sample).max():  # they differ by rounding at most
        return float(sample[0]), float(sample[0])
    rng = np.random.default_rng(seed)
    found = bootstrap((sample,), np.mean, n_resamples=RESAMPLES, confidence_level=LEVEL, method="BCa", rng=rng)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
