"""Limits of what a participant's link may append to the session's log: a rate and a size.

Beyond the size only necessary events are written: first answers, finished questionnaires, tasks that begin. Regular
participants stay far below both limits.
"""

from __future__ import annotations

import math

from glsplat.errors import ProtocolError
from glsplat.net.guard.limits import Bucket

MAX_LOG_BYTES = 64 << 20
"""Size of a session's log; an hour of a study with 100 questions writes about 30 kB."""
RATE_BYTES_S = 4096.0
BURST_BYTES = 1 << 20
"""Twenty answers of 4000 characters, each escaped to 12 bytes."""


class QuotaError(ProtocolError):
    """A limit is exceeded; ``wait`` is the number of seconds until the next try."""

    def __init__(self, message: str, code: str, wait: int | None = None) -> None:
        super().__init__(message, code)
        self.wait = wait


class LinkQuota:
    """Quota of one link. Times are of a monotonic clock. One message may overdraw it; the next one waits."""

    def __init__(self, now: float) -> None:
        self._bucket = Bucket.full(RATE_BYTES_S, BURST_BYTES, now)

    def check(self, now: float, size: int, makes_progress: bool) -> None:
        """Raise QuotaError: "full" for a log of ``size`` bytes unless the event is needed, "rate" for a high rate."""
        if size >= MAX_LOG_BYTES and not makes_progress:
            raise QuotaError(
                f"the log of this session is full ({MAX_LOG_BYTES >> 20} MiB): saved answers stay, "
                "and a running task is not restarted",
                "full",
            )
        if (left := self._bucket.left(now)) <= 0:
            wait = math.ceil(-left / self._bucket.rate) or 1
            raise QuotaError(f"answers arrive faster than they can be saved; try again in {wait} s", "rate", wait)

    def charge(self, now: float, nbytes: int) -> None:
        """Charge appended bytes."""
        self._bucket.charge(now, nbytes)
