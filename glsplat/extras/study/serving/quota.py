"""How much the participant's link may append to the session's log: bytes a second, and a size.

Beyond the size only what leads on to the end is written: first answers, finished questionnaires, tasks that begin. An
honest participant never comes near either limit.
"""

from __future__ import annotations

import math

from glsplat.errors import ProtocolError
from glsplat.net.guard.limits import Bucket

__all__ = ["MAX_LOG_BYTES", "LinkQuota", "QuotaError"]

MAX_LOG_BYTES = 64 << 20
"""Of a session's log; an hour of a study with 100 questions writes some 30 kB."""
RATE_BYTES_S = 4096.0
BURST_BYTES = 1 << 20
"""Twenty answers of 4000 characters, each of them written as 12 bytes."""


class QuotaError(ProtocolError):
    """The link wants to append too much; ``wait``: seconds after which it may."""

    def __init__(self, message: str, code: str, wait: int | None = None) -> None:
        super().__init__(message, code)
        self.wait = wait


class LinkQuota:
    """One link's. Times are of any clock that does not run backwards. A message may overdraw it, the next one waits."""

    def __init__(self, now: float) -> None:
        self._bucket = Bucket.full(RATE_BYTES_S, BURST_BYTES, now)

    def check(self, now: float, size: int, leads_on: bool) -> None:
        """Raises QuotaError: "full" where the log has ``size`` bytes and this is not needed, "rate" for too many."""
        if size >= MAX_LOG_BYTES and not leads_on:
            raise QuotaError(
                f"the log of this session is full ({MAX_LOG_BYTES >> 20} MiB): answers that are saved stay as they "
                "are, and a task that is under way is not begun anew",
                "full",
            )
        if (left := self._bucket.left(now)) <= 0:
            wait = math.ceil(-left / self._bucket.rate) or 1
            raise QuotaError(f"answers come faster than they are written down; try again in {wait} s", "rate", wait)

    def charge(self, now: float, nbytes: int) -> None:
        """So much was appended."""
        self._bucket.charge(now, nbytes)
