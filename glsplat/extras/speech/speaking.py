"""Weights of a speaking mouth over a whole sound."""

from __future__ import annotations

from collections.abc import Mapping
from math import exp

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.analysis import Analysis, table
from glsplat.extras.speech.sound import Sound


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


_BLOCK_SAMPLES = 1 << 16
_REST_S = 0.5  # silence in which the mouth comes to rest


class Speaking:
    """Weights of ARKit's shapes over ``sound``. Raises FormatError for a rate below 16 kHz.

    >>> speaking = Speaking(Sound(np.zeros(16000, np.float32), 16000))
    >>> speaking.at(0.5)["jawOpen"]
    0.0
    """

    def __init__(self, sound: Sound) -> None:
        analysis, mouth = Analysis(sound.rate), Mouth()
        times, rows = [], []
        padded = np.concatenate([sound.samples, np.zeros(round(_REST_S * sound.rate), np.float32)])
        for first in range(0, len(padded), _BLOCK_SAMPLES):
            for time, visemes, level in analysis.add(padded[first : first + _BLOCK_SAMPLES]):
                times.append(time)
                weights = mouth.add(visemes, level)
                self.names: tuple[str, ...] = tuple(weights)
                rows.append(np.array(list(weights.values())))
        self._times = np.array(times)
        self._least = table().least
        self._weights = np.array(rows)

    def at(self, seconds: float) -> Mapping[str, float]:
        """Return the weights at that time; those of the first or last frame outside the sound."""
        i = min(max(int(np.searchsorted(self._times, seconds)) - 1, 0), len(self._times) - 1)
        weights = self._weights[i]
        return dict(zip(self.names, np.where(weights < self._least, 0.0, weights).tolist(), strict=True))
