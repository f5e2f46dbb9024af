"""The effects of a full factorial design and the contrasts of cell means that test them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.linalg import helmert

from glsplat.arrays import F64

Effect = tuple[int, ...]
"""Indices of an effect's factors: (0,) is a main effect, (0, 2) an interaction."""


def effects_of(count: int) -> list[Effect]:
    """Return all main effects and interactions of ``count`` factors, those of few factors first (the order of R)."""
    return [effect for size in range(1, count + 1) for effect in combinations(range(count), size)]


@lru_cache(maxsize=256)
def hypothesis(shape: tuple[int, ...], effect: Effect) -> F64:
    """Return the contrasts [d, prod(shape)] of cell means that are 0 without the effect; rows are orthonormal.

    Cells weigh the same, however many answers they have: type III sums of squares (sum contrasts in R).
    """
    parts = [helmert(n) if i in effect else np.full((1, n), 1 / math.sqrt(n)) for i, n in enumerate(shape)]
    out = kron(parts)
    out.flags.writeable = False  # cached
    return out


def averages(shape: Sequence[int], effect: Effect) -> F64:
    """Return the weights [K, prod(shape)] of estimated marginal means, a row for each of the effect's K cells."""
    parts = [np.eye(n) if i in effect else np.full((1, n), 1 / n) for i, n in enumerate(shape)]
    return kron(parts)


def kron(parts: Sequence[F64]) -> F64:
    """Return the Kronecker product of all ``parts``; [[1]] for none."""
    out: F64 = np.ones((1, 1))
    for part in parts:
        out = np.asarray(np.kron(out, part), np.float64)
    return out
