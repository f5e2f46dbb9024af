"""Sounds made in code: a buzz through resonances, as vowels are, and closures."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from glsplat.extras.speech.sound import Sound

FORMANTS = {"aa": (750, 1200, 2600), "I": (300, 2300, 3000), "O": (500, 850, 2500)}


def vowels(seconds: float, rate: int, pitch: float = 120.0, each: float = 0.25) -> NDArray[np.float64]:
    """[N] about half of full scale: the vowels in turn, ``each`` so many seconds."""
    t = np.arange(int(seconds * rate)) / rate
    kinds = np.array([list(FORMANTS.values())[int(k) % 3] for k in t / each], float)
    out = np.zeros(len(t))
    for harmonic in range(1, int(min(4000, 0.45 * rate) / pitch)):
        f = pitch * harmonic
        gain = sum(1 / (1 + ((f - kinds[:, i]) / (80 + 40 * i)) ** 2) for i in range(3)) / harmonic**0.5
        out += gain * np.sin(2 * np.pi * f * t)
    return 0.5 * out / np.abs(out).max()


def wav_bytes(sound: Sound) -> bytes:
    """Return the sound as a .wav of 16 bits."""
    body = np.rint(sound.samples.clip(-1, 1) * 32767).astype("<i2").tobytes()
    form = struct.pack("<HHIIHH", 1, 1, sound.rate, 2 * sound.rate, 2, 16)
    chunks = b"fmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(body)) + body
    return b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WAVE" + chunks
