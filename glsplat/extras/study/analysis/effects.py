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
"""Places of the factors that an effect is of: (0,) a main effect, (0, 2) an interaction."""


def effects_of(count: int) -> list[Effect]:
    """Every main effect and interaction of so many factors, those of few factors first (the order of R)."""
    return [effect for size in range(1, count + 1) for effect in combinations(range(count), size)]


@lru_cache(maxsize=256)
def hypothesis(shape: tuple[int, ...], effect: Effect) -> F64:
    """What the cell means [prod(shape)] times this matrix's rows are 0 under: no such effect.

    Every cell counts alike, however many answers it has: type III sums of squares (sum contrasts in R). Rows are
    orthonormal.
    """
    parts = [helmert(n) if i in effect else np.full((1, n), 1 / math.sqrt(n)) for i, n in enumerate(shape)]
    out = kron(parts)
    out.flags.writeable = False  # kept for the next call
    return out


def averages(shape: Sequence[int], effect: Effect) -> F64:
    """The means over all other factors, one row a combination of the effect's levels: estimated marginal means."""
    parts = [np.eye(n) if i in effect else np.full((1, n), 1 / n) for i, n in enumerate(shape)]
    return kron(parts)


def kron(parts: Sequence[F64]) -> F64:
    """The Kronecker product of all of them; [[1]] of none."""
    out: F64 = np.ones((1, 1))
    for part in parts:
        out = np.asarray(np.kron(out, part), np.float64)
    return out
