"""Number of parity pieces of a picture. No I/O."""

from __future__ import annotations

from functools import lru_cache
from math import exp

_FAILS = 0.003  # accepted share of pictures that cannot be restored
_MOST = 0.4  # most parity pieces a piece: a link that needs more is unfit for pictures


def parity_for(pieces: int, loss: float) -> int:
    """Return the fewest parity pieces by which all but ``_FAILS`` of pictures survive independent packet ``loss``."""
    return _parity(pieces, round(min(loss, 0.5), 4))


@lru_cache(4096)
def _parity(pieces: int, loss: float) -> int:
    most = max(2, round(_MOST * pieces))
    for parity in range(most):
        mean = (pieces + parity) * loss  # Poisson, slightly above the binomial law
        term = left = exp(-mean)
        for lost in range(1, parity + 1):
            term *= mean / lost
            left += term
        if 1 - left <= _FAILS:
            return parity
    return most
