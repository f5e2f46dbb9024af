"""Rate-limited log lines for events that strangers cause: one a minute of each kind, without text of theirs."""

from __future__ import annotations

import logging
from collections.abc import Callable

INTERVAL_S = 60.0  # between lines of one kind

log: logging.Logger = logging.getLogger("glsplat.net")


class Notices:
    """Log ``notices("kind", "text")`` as a warning unless one of that kind was logged within INTERVAL_S."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._logged: dict[str, tuple[float, int]] = {}  # kind: time of the last line, notices since

    def __call__(self, kind: str, text: str) -> None:
        """Log a notice; ``kind`` is one of a few words of the program, never of a peer."""
        now = self._clock()
        last, left_out = self._logged.get(kind, (float("-inf"), 0))
        if now - last < INTERVAL_S:
            self._logged[kind] = last, left_out + 1
            return
        self._logged[kind] = now, 0
        log.warning("%s%s", text, f" ({left_out} more like it since the last line)" if left_out else "")
