"""StageTimes: the times of the stages of the last frames, as median and 95th percentile."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np


def median_p95(values: Iterable[float]) -> tuple[float, float]:
    """Return median and 95th percentile; zeros for no values."""
    array = np.fromiter(values, np.float64)
    if not len(array):
        return 0.0, 0.0
    median, p95 = np.percentile(array, (50, 95))
    return float(median), float(p95)


class StageTimes:
    """Times of the last ``length`` frames, by stage."""

    def __init__(self, length: int = 256) -> None:
        self.frames: int = 0
        self._length = length
        self._values: dict[str, deque[float]] = {}
        self._at: deque[float] = deque([float("-inf")], maxlen=length)

    def add(self, times: Mapping[str, float]) -> None:
        """Add a frame's times in ms."""
        self.frames += 1
        self._at.append(time.monotonic())
        for name, ms in times.items():
            self._values.setdefault(name, deque(maxlen=self._length)).append(ms)

    def lately(self, seconds: float = 1.0) -> bool:
        """Return whether a frame was added in the last ``seconds``."""
        return time.monotonic() - self._at[-1] < seconds

    def summary(self) -> dict[str, dict[str, float]]:
        """Return {stage: {"median", "p95"}} in ms."""
        pairs = {name: median_p95(values) for name, values in self._values.items()}
        return {name: {"median": round(m, 3), "p95": round(p, 3)} for name, (m, p) in pairs.items()}

    def fps(self) -> float:
        """Return the frames a second of all clients together, over the last five seconds."""
        now = time.monotonic()
        return sum(now - at < 5.0 for at in self._at) / 5.0
