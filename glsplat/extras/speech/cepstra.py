"""Mel-frequency cepstra of sound, frame by frame, at any sample rate (Davis & Mermelstein 1980).

Levels are relative to the peak of the last seconds, so that quiet and loud microphones work equally.
"""

from __future__ import annotations

from math import ceil, floor, log2, pi

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError
from glsplat.extras.speech.table import Framing

MIN_RATE_HZ = 16000
"""Lower rates have no sibilants."""
MAX_RATE_HZ = 384000


class Cepstra:
    """A stream of sound at ``rate`` samples per second, fed in pieces of any length.

    Raises FormatError for a rate below 16 or above 384 kHz.
    """

    def __init__(self, framing: Framing, rate: float) -> None:
        if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
            raise FormatError(f"speech needs {MIN_RATE_HZ} to {MAX_RATE_HZ} samples a second, not {rate:g}")
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
        self._received = self._frames = 0  # samples, frames
        self._peak = f.start

    def add(self, samples: NDArray[np.floating]) -> list[tuple[NDArray[np.float64], float]]:
        """Return cepstrum and decibels below the peak for each frame that ends within ``samples`` [N], full scale 1.

        Frame k ends k hops after the first sample. Values that are not finite count as silence.
        """
        fresh = np.nan_to_num(np.asarray(samples, np.float64), nan=0.0, posinf=0.0, neginf=0.0).clip(-4, 4)
        self._sound = np.concatenate([self._sound, fresh])
        self._received += len(fresh)
        out = []
        while (end := floor(self._frames * self._framing.hop * self._rate + 0.5)) <= self._received:
            stop = len(self._sound) - (self._received - end)
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
    """Return triangular filters [bands, size / 2 + 1], evenly spaced on the mel scale."""
    low, high = (2595 * np.log10(1 + hertz / 700) for hertz in (f.low, f.high))
    edges = 700 * (10 ** (np.linspace(low, high, f.bands + 2) / 2595) - 1)
    hertz = np.arange(size // 2 + 1) * rate / size
    rising = (hertz - edges[:-2, None]) / np.diff(edges)[:-1, None]
    falling = (edges[2:, None] - hertz) / np.diff(edges)[1:, None]
    return np.maximum(0, np.minimum(rising, falling))
