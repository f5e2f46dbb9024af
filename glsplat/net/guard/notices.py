"""Log lines that strangers can cause: one a minute of each kind, short, never with anything they sent."""

from __future__ import annotations

import logging
from collections.abc import Callable

__all__ = ["Notices"]


class Notices:
    """``notices("kind", "text")`` logs a warning, unless one of its kind was logged less than ``every`` seconds ago."""

    def __init__(self, log: logging.Logger, clock: Callable[[], float], every: float = 60.0) -> None:
        self._log, self._clock, self._every = log, clock, every
        self._said: dict[str, tuple[float, int]] = {}  # kind: when, how often since

    def __call__(self, kind: str, text: str) -> None:
        """``kind`` is one of a few words of the program's own, never of a peer's."""
        now = self._clock()
        last, left_out = self._said.get(kind, (float("-inf"), 0))
        if now - last < self._every:
            self._said[kind] = last, left_out + 1
            return
        self._said[kind] = now, 0
        self._log.warning("%s%s", text, f" ({left_out} more like it since the last line)" if left_out else "")
