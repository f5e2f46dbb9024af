"""Which of a client's messages is read, where the time for reading does not suffice for all: the newest."""

from __future__ import annotations

from glsplat.net.guard.limits import CpuShare

__all__ = ["Reading"]

_SHORT = 64  # characters of a message that is always read: an acknowledgement, which costs next to nothing


class Reading:
    """One client's line: at most one message, which waits for the client's part of the time to come back."""

    def __init__(self, share: CpuShare) -> None:
        self.share = share
        self.left_out = 0  # messages dropped unread for newer ones
        self._held: str | None = None

    def offer(self, text: str, now: float) -> str | None:
        """A message came: the one to read now, or None: it waits."""
        if len(text) <= _SHORT:
            return text
        self.left_out += self._held is not None
        self._held = None
        if self.share.left(now):
            return text
        self._held = text
        return None

    def wait(self, now: float) -> float:
        """Seconds until ``take`` has something to read; infinity: nothing waits."""
        return float("inf") if self._held is None else self.share.wait(now)

    def take(self) -> str | None:
        """The message that waited, if any."""
        text, self._held = self._held, None
        return text
