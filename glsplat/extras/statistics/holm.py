"""Correct p values for multiple tests."""

from __future__ import annotations

from collections.abc import Sequence


def holm(p: Sequence[float]) -> list[float]:
    """Return p values corrected for multiple tests (Holm 1979), in the order of ``p``."""
    corrected = [0.0] * len(p)
    worst = 0.0
    for place, index in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        worst = max(worst, min(1.0, (len(p) - place) * p[index]))
        corrected[index] = worst
    return corrected
