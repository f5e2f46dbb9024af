"""Visemes from sound: a small network over the cepstra of some frames. Twin: ``web/voice/analysis.js``."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from math import ceil, floor, log2, pi
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from glsplat.errors import FormatError


@dataclass(frozen=True, slots=True)
class Framing:
    """Framing of sound. Times in seconds, frequencies in hertz; levels are powers relative to full scale."""

    hop: float  # seconds from frame to frame
    window: float  # seconds of a frame
    bands: int  # on the mel scale from ``low`` to ``high``
    low: float
    high: float
    coefficients: int  # of the cosine transform over the bands
    tiny: float  # fraction of the peak below which sound counts as silence
    start: float  # initial level of the peak ...
    least: float  # ... and its minimum
    half_life: float  # seconds in which the peak falls by half


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Parameters made by ``tools/data/visemes.py``."""

    framing: Framing
    ahead: int  # later frames used for a frame
    offsets: tuple[int, ...]  # of the frames used, from the newest
    hidden: tuple[NDArray[np.float64], NDArray[np.float64]]  # [offsets * coefficients, H], [H]
    output: tuple[NDArray[np.float64], NDArray[np.float64]]  # [H, V], [V]
    visemes: Mapping[str, Mapping[str, float]]  # weights of ARKit's shapes by viseme
    closes: str  # the viseme with closed lips
    closed: tuple[float, float]  # its probability at which lips begin to close, and are closed
    opens: float  # seconds in which closed lips open
    smooth: float  # seconds, time constant of all other movements
    least: float  # weights below it are noise
    jaw: tuple[float, float]  # share of jawOpen in silence, and decibels below the peak of silence


@cache
def table() -> Table:
    """Return the parsed table."""
    found = json.loads((resources.files("glsplat.extras.speech") / "web" / "voice" / "visemes.json").read_bytes())
    sound, net, mouth = found["sound"], found["network"], found["mouth"]
    return Table(
        framing=Framing(**sound),
        ahead=net["ahead"],
        offsets=tuple(net["offsets"]),
        hidden=(np.array(net["hidden"]), np.array(net["hidden_bias"])),
        output=(np.array(net["output"]), np.array(net["output_bias"])),
        visemes=MappingProxyType({name: MappingProxyType(weights) for name, weights in found["visemes"].items()}),
        closes=mouth["closes"],
        closed=tuple(mouth["closed"]),
        opens=mouth["opens"],
        smooth=mouth["smooth"],
        least=mouth["least"],
        jaw=tuple(mouth["jaw"]),
    )


MIN_RATE_HZ = 16000
"""Lower rates have no sibilants."""
MAX_RATE_HZ = 384000


class Cepstra:
    """A stream of sound at ``rate`` samples per second, fed in pieces of any length (Davis & Mermelstein 1980).

    Levels are relative to the peak of the last seconds, so that quiet and loud microphones work equally.
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
