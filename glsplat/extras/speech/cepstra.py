"""Sound to mel-frequency cepstra, frame by frame, at any sample rate (Davis & Mermelstein 1980).

Levels count from the loudest of the last seconds, so that a quiet microphone speaks as clearly as a loud one.
"""

from __future__ import annotations

from math import ceil, floor, log2, pi

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.speech.table import Framing

__all__ = ["SLOWEST", "Cepstra"]

SLOWEST = 16000
"""Samples a second that are needed: below there are no sibilants."""
_FASTEST = 384000


class Cepstra:
    """A stream of sound at ``rate`` samples a second. Feed it pieces of any length: the pieces make no difference.

    Raises FormatError for a rate below 16 or above 384 kHz.
    """

    def __init__(self, framing: Framing, rate: float) -> None:
        if not SLOWEST <= rate <= _FASTEST:
            raise FormatError(f"speech needs {SLOWEST} to {_FASTEST} samples a second, not {rate:g}")
        self._framing = f = framing
        self._rate = rate
        self._length = n = floor(f.window * rate + 0.5)
        self._size = 1 << ceil(log2(n))
        self._window = 0.5 - 0.5 * np.cos(2 * pi * (np.arange(n) + 0.5) / n)
        self._bank = _bank(f, rate, self._size) * (2 / (np.square(self._window).sum() * self._size))
        scale = np.full((f.coefficients, 1), (2 / f.bands) ** 0.5)
        scale[0] = f.bands**-0.5
        self._cosines = scale * np.cos(pi * np.arange(f.coefficients)[:, None] * (np.arange(f.bands) + 0.5) / f.bands)
        self._decay = 0.5 ** (f.hop / f.half_life)
        self._sound = np.zeros(n)  # silence before the first sample
        self._heard = self._frames = 0  # samples, frames
        self._peak = f.start

    def add(self, samples: NDArray[np.floating]) -> list[tuple[NDArray[np.float64], float]]:
        """Of each frame that ends within ``samples`` [N] (full scale is 1), its cepstrum, and decibels below the peak.

        Frame k ends k hops after the first sample. What is not finite is silence.
        """
        fresh = np.nan_to_num(np.asarray(samples, np.float64), nan=0.0, posinf=0.0, neginf=0.0).clip(-4, 4)
        self._sound = np.concatenate([self._sound, fresh])
        self._heard += len(fresh)
        out = []
        while (end := floor(self._frames * self._framing.hop * self._rate + 0.5)) <= self._heard:
            stop = len(self._sound) - (self._heard - end)
            out.append(self._of(self._sound[stop - self._length : stop]))
            self._frames += 1
        self._sound = self._sound[-(self._length + ceil(self._framing.hop * self._rate) + 1) :]
        return out

    def _of(self, frame: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
        f = self._framing
        spectrum = np.fft.rfft((frame - frame.mean()) * self._window, self._size)
        energies = self._bank @ (spectrum.real**2 + spectrum.imag**2)
        level = float(energies.sum())
        self._peak = max(self._peak * self._decay, level, f.least)
        cepstrum = self._cosines @ np.log(energies / self._peak + f.tiny)
        return cepstrum, 10 * float(np.log10(level / self._peak + f.tiny))


def _bank(f: Framing, rate: float, size: int) -> NDArray[np.float64]:
    """[bands, size / 2 + 1] triangles that are even on the mel scale."""
    low, high = (2595 * np.log10(1 + hertz / 700) for hertz in (f.low, f.high))
    edges = 700 * (10 ** (np.linspace(low, high, f.bands + 2) / 2595) - 1)
    hertz = np.arange(size // 2 + 1) * rate / size
    rising = (hertz - edges[:-2, None]) / np.diff(edges)[:-1, None]
    falling = (edges[2:, None] - hertz) / np.diff(edges)[1:, None]
    return np.maximum(0, np.minimum(rising, falling))
