"""How many parity pieces a picture gets. No I/O."""

from __future__ import annotations

from functools import lru_cache
from math import exp

_FAILS = 0.003  # of the pictures that may not be put together
_MOST = 0.4  # parity pieces a piece: more than that is no link for pictures


def parity_for(pieces: int, loss: float) -> int:
    """The fewest parity pieces beside ``pieces`` by which all but ``_FAILS`` are whole; packets are lost singly."""
    return _parity(pieces, round(min(loss, 0.5), 4))


@lru_cache(4096)
def _parity(pieces: int, loss: float) -> int:
    most = max(2, round(_MOST * pieces))
    for parity in range(most):
        mean = (pieces + parity) * loss  # Poisson, which says a little more than the binomial law
        term = left = exp(-mean)
        for lost in range(1, parity + 1):
            term *= mean / lost
            left += term
        if 1 - left <= _FAILS:
            return parity
    return most
