"""Sound to visemes: cepstra of short frames, as of a mel scale, and a small network over some of them.

Mel-frequency cepstra are those of Davis & Mermelstein 1980, at any sample rate. Levels count from the loudest of the
last seconds, so that a quiet microphone speaks as clearly as a loud one. ``net/web/voice/analysis.js`` is the same.
"""

from __future__ import annotations

from collections import deque
from math import ceil, floor, log2, pi

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.speech.table import Table, table

__all__ = ["SLOWEST", "Analysis"]

SLOWEST = 16000
"""Samples a second that are needed: below there are no sibilants."""
_FASTEST = 384000


class Analysis:
    """A stream of sound at ``rate`` samples a second. Feed it pieces of any length: the pieces make no difference.

    Raises FormatError for a rate below 16 or above 384 kHz.
    """

    def __init__(self, rate: float) -> None:
        if not SLOWEST <= rate <= _FASTEST:
            raise FormatError(f"speech needs 16000 to 384000 samples a second, not {rate:g}")
        self._table = t = table()
        self._rate = rate
        self._length = floor(t.window * rate + 0.5)
        self._size = 1 << ceil(log2(self._length))
        n = self._length
        self._window = 0.5 - 0.5 * np.cos(2 * pi * (np.arange(n) + 0.5) / n)
        self._bank = _bank(t, rate, self._size) * (2 / (np.square(self._window).sum() * self._size))
        angles = pi * np.arange(t.coefficients)[:, None] * (np.arange(t.bands) + 0.5) / t.bands
        scale = np.full((t.coefficients, 1), (2 / t.bands) ** 0.5)
        scale[0] = t.bands**-0.5
        self._cosines = np.cos(angles) * scale
        self._decay = 0.5 ** (t.hop / t.half_life)
        self.reset()

    def reset(self) -> None:
        """Forget what was heard."""
        t = self._table
        self._sound = np.zeros(self._length)  # silence before the first sample
        self._heard = 0  # samples
        self._frames = 0
        self._peak = t.start
        self._past: deque[NDArray[np.float64]] = deque(maxlen=1 - min(t.offsets))
        self._levels: deque[float] = deque(maxlen=t.ahead + 1)  # decibels below the peak

    def add(self, samples: NDArray[np.floating]) -> list[tuple[float, NDArray[np.float64], float]]:
        """The frames that end within ``samples`` [N] (full scale is 1): for each, the second of the sound that it is
        about, the probabilities of the table's visemes [V], and the level there in decibels below the peak.

        What is not finite is silence.
        """
        fresh = np.nan_to_num(np.asarray(samples, np.float64), nan=0.0, posinf=0.0, neginf=0.0).clip(-4, 4)
        self._sound = np.concatenate([self._sound, fresh])
        self._heard += len(fresh)
        t, out = self._table, []
        while (end := floor(self._frames * t.hop * self._rate + 0.5)) <= self._heard:
            stop = len(self._sound) - (self._heard - end)
            visemes, level = self._judged(self._sound[stop - self._length : stop])
            out.append(((self._frames - t.ahead) * t.hop - t.window / 2, visemes, level))
            self._frames += 1
        self._sound = self._sound[-(self._length + ceil(t.hop * self._rate) + 1) :]
        return out

    def _judged(self, frame: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        t = self._table
        spectrum = np.fft.rfft((frame - frame.mean()) * self._window, self._size)
        energies = self._bank @ (spectrum.real**2 + spectrum.imag**2)
        level = float(energies.sum())
        self._peak = max(self._peak * self._decay, level, t.least)
        cepstrum = self._cosines @ np.log(energies / self._peak + t.tiny)
        self._past.append(cepstrum)
        self._levels.append(10 * float(np.log10(level / self._peak + t.tiny)))
        while len(self._past) < (self._past.maxlen or 0):  # what was before the beginning is as it
            self._past.appendleft(cepstrum)
        seen = np.concatenate([self._past[offset - 1] for offset in t.offsets])
        logits = np.tanh(seen @ t.hidden[0] + t.hidden[1]) @ t.output[0] + t.output[1]
        likely = np.exp(logits - logits.max())
        return likely / likely.sum(), self._levels[0]


def _bank(t: Table, rate: float, size: int) -> NDArray[np.float64]:
    """[bands, size / 2 + 1] triangles that are even on the mel scale."""
    low, high = (2595 * np.log10(1 + f / 700) for f in (t.low, t.high))
    edges = 700 * (10 ** (np.linspace(low, high, t.bands + 2) / 2595) - 1)
    f = np.arange(size // 2 + 1) * rate / size
    rising = (f - edges[:-2, None]) / np.diff(edges)[:-1, None]
    falling = (edges[2:, None] - f) / np.diff(edges)[1:, None]
    return np.maximum(0, np.minimum(rising, falling))
