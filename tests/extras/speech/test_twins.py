"""Sound to mouth shapes in Python and in the page (web/voice): the same answers for the same vectors."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np

from glsplat.extras.speech.analysis import Analysis
from glsplat.extras.speech.speaking import Mouth
from tests.extras.speech.sounds import vowels
from tests.twins import Twin, both_sides, text_of


def heard(rate: int, piece: int, samples: str) -> list[list[float]]:
    """Return [time, level, *visemes, *mouth shapes] of each frame; ``samples``: 16 bits each, in base64."""
    sound = np.frombuffer(base64.b64decode(samples), "<i2") / 2**15
    analysis, mouth, out = Analysis(rate), Mouth(), []
    for first in range(0, len(sound), piece):
        for time, visemes, level in analysis.add(sound[first : first + piece]):
            out.append([time, level, *visemes.tolist(), *mouth.add(visemes, level).values()])
    return out


def sounds() -> list[dict[str, Any]]:
    out = []
    for rate, seconds, piece in ((16000, 0.4, 128), (16000, 0.05, 1), (44100, 0.15, 1000), (48000, 0.1, 4801)):
        sound = 0.9 * vowels(seconds, rate, each=seconds / 2)
        sound[: len(sound) // 4] *= 0.01  # quiet first
        sound[len(sound) // 2 : len(sound) // 2 + 20] = 0.999  # clipped
        sound[-len(sound) // 4 :] = 0  # silence, and noise
        sound[-len(sound) // 8 :] = np.random.default_rng(rate).normal(0, 0.1, len(sound[-len(sound) // 8 :]))
        data = np.rint(np.clip(sound, -1, 0.9999) * 2**15).astype("<i2")
        out.append({"rate": rate, "piece": piece, "samples": text_of(data.tobytes())})
    return out


TWINS = {"heard": Twin(heard, sounds)}

test_python_gives_the_vectors, test_the_page_gives_the_vectors = both_sides(Path(__file__).parent, TWINS)
