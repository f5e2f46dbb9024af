"""Weights of ARKit's shapes from visemes: smoothed, the jaw by loudness; lips close at once and open slowly.

Twin: ``web/voice/mouth.js``.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import exp

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.table import table


class Mouth:
    """One mouth, at rest in silence."""

    def __init__(self) -> None:
        self._table = t = table()
        self._names = sorted({name for weights in t.visemes.values() for name in weights})
        self._shapes = np.array([[w.get(name, 0.0) for name in self._names] for w in t.visemes.values()])
        self._closing = list(t.visemes).index(t.closes)
        self._jaw = self._names.index("jawOpen")
        self._smoothing = 1 - exp(-t.framing.hop / t.smooth)
        self._mixed = np.zeros(len(t.visemes))
        self._mixed[0] = 1.0
        self._closed = 0.0

    def add(self, visemes: NDArray[np.float64], level: float) -> Mapping[str, float]:
        """Return the weights of all shapes, 0 to 1, after a further frame of ``Analysis``."""
        t = self._table
        self._mixed = self._mixed + (visemes - self._mixed) * self._smoothing
        begins, full = t.closed
        now = min(1.0, max(0.0, (float(visemes[self._closing]) - begins) / (full - begins)))
        self._closed = max(now, self._closed - t.framing.hop / t.opens)
        others = self._mixed.copy()
        others[self._closing] = 0.0
        weights = others @ self._shapes
        least, silence = t.jaw
        loud = min(1.0, max(0.0, 1 + level / silence))
        weights[self._jaw] *= least + (1 - least) * loud
        weights = weights * (1 - self._closed) + self._shapes[self._closing] * self._closed
        return dict(zip(self._names, weights.tolist(), strict=True))
