"""Visemes from sound: a small network over the cepstra of some frames. Twin: ``web/voice/analysis.js``."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.cepstra import Cepstra
from glsplat.extras.speech.table import table


class Analysis:
    """Analyses a stream of sound at ``rate`` samples per second, 16 to 384 kHz (else FormatError), in pieces."""

    def __init__(self, rate: float) -> None:
        self._table = t = table()
        self._cepstra = Cepstra(t.framing, rate)
        self._frames = 0
        self._past: deque[NDArray[np.float64]] = deque(maxlen=1 - min(t.offsets))
        self._levels: deque[float] = deque(maxlen=t.ahead + 1)

    def add(self, samples: NDArray[np.floating]) -> list[tuple[float, NDArray[np.float64], float]]:
        """Return a tuple for each frame that ends within ``samples`` [N]: its time in the sound in seconds, the
        probabilities of the table's visemes [V], and its level in decibels relative to the recent peak.
        """
        t, out = self._table, []
        for cepstrum, level in self._cepstra.add(samples):
            self._past.append(cepstrum)
            self._levels.append(level)
            while len(self._past) < (self._past.maxlen or 0):  # repeat the first frame before the beginning
                self._past.appendleft(cepstrum)
            inputs = np.concatenate([self._past[offset - 1] for offset in t.offsets])
            logits = np.tanh(inputs @ t.hidden[0] + t.hidden[1]) @ t.output[0] + t.output[1]
            exponentials = np.exp(logits - logits.max())
            time = (self._frames - t.ahead) * t.framing.hop - t.framing.window / 2
            out.append((time, exponentials / exponentials.sum(), self._levels[0]))
            self._frames += 1
        return out
