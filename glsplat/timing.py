"""Stage timer: wall-clock milliseconds between marks."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["StageTimer"]


class StageTimer:
    """Time the stages of a frame: ``start()``, then ``mark("name")`` after each; ``ms`` has the last frame's times.

    Without ``finish`` a stage is the CPU time of issuing it, as GL commands run deferred, also on software rasterizers.
    With it, every mark waits for the GPU, which makes stages exact and frames slower.
    """

    def __init__(self, finish: Callable[[], None] | None = None) -> None:
        self._finish = finish
        self._start = self._last = 0.0
        self.ms: dict[str, float] = {}

    def start(self) -> None:
        """Begin a frame."""
        self.ms = {}
        self._start = self._last = time.perf_counter()

    def mark(self, stage: str) -> None:
        """End a stage; times of one name add up."""
        if self._finish is not None:
            self._finish()
        now = time.perf_counter()
        self.ms[stage] = self.ms.get(stage, 0.0) + (now - self._last) * 1e3
        self._last = now

    def stop(self) -> None:
        """End the frame; ``ms["total"]`` is the time since start()."""
        self.ms["total"] = (time.perf_counter() - self._start) * 1e3
