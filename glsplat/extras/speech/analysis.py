"""Sound to visemes: a small network over the cepstra of some frames. ``web/voice/analysis.js`` is its twin."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.cepstra import Cepstra
from glsplat.extras.speech.table import table

__all__ = ["Analysis"]


class Analysis:
    """A stream of sound at ``rate`` samples a second, 16 to 384 kHz (else FormatError), in pieces of any length."""

    def __init__(self, rate: float) -> None:
        self._table = t = table()
        self._cepstra = Cepstra(t.framing, rate)
        self._frames = 0
        self._past: deque[NDArray[np.float64]] = deque(maxlen=1 - min(t.offsets))
        self._levels: deque[float] = deque(maxlen=t.ahead + 1)

    def add(self, samples: NDArray[np.floating]) -> list[tuple[float, NDArray[np.float64], float]]:
        """Of each frame that ends within ``samples`` [N]: the second of the sound that it is about, the probabilities
        of the table's visemes [V], and the level there, in decibels below the peak of the last seconds.
        """
        t, out = self._table, []
        for cepstrum, level in self._cepstra.add(samples):
            self._past.append(cepstrum)
            self._levels.append(level)
            while len(self._past) < (self._past.maxlen or 0):  # what was before the beginning is as it
                self._past.appendleft(cepstrum)
            seen = np.concatenate([self._past[offset - 1] for offset in t.offsets])
            logits = np.tanh(seen @ t.hidden[0] + t.hidden[1]) @ t.output[0] + t.output[1]
            likely = np.exp(logits - logits.max())
            time = (self._frames - t.ahead) * t.framing.hop - t.framing.window / 2
            out.append((time, likely / likely.sum(), self._levels[0]))
            self._frames += 1
        return out
