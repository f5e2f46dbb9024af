"""Weights of a speaking mouth over a whole sound."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from glsplat.extras.speech.analysis import Analysis
from glsplat.extras.speech.mouth import Mouth
from glsplat.extras.speech.sound import Sound
from glsplat.extras.speech.table import table

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
