"""Count a client's WebSocket frames by their headers alone (RFC 6455, section 5.2), before any parser."""

from __future__ import annotations

from dataclasses import dataclass

from glsplat.net.guard.limits import ClientQuota, Limits

PROTOCOL_ERROR = 1002  # RFC 6455, section 7.4.1
POLICY_VIOLATION = 1008


@dataclass(frozen=True, slots=True)
class Breach:
    """Why a connection ends. The client receives ``reason``."""

    code: int  # of the close
    reason: str


class FrameMeter:
    """Follow the frames in one connection's bytes, and take each from the client's quota.

    A breach is found at the first header beyond a limit; bytes behind it are never read.
    """

    def __init__(self, quota: ClientQuota, limits: Limits) -> None:
        self._quota, self._limits = quota, limits
        self._head = bytearray()  # of an incomplete header
        self._skip = 0  # bytes of payload to come

    def expect_answer(self, now: float) -> None:
        """Allow the pong of a ping that is sent."""
        self._quota.control.charge(now, -1.0)

    def feed(self, data: bytes, now: float) -> tuple[int, Breach | None]:
        """Return the number of bytes of ``data`` that may be read, and the breach behind them."""
        if not self._quota.bytes.take(now, len(data)):
            return 0, Breach(POLICY_VIOLATION, f"more than {self._limits.bytes / 1024:g} KiB a second")
        position, size = 0, len(data)
        if self._head and size:
            # the first bytes complete the header that the last ones began
            wanted = min(_MAX_HEADER - len(self._head), size)
            known = len(self._head)
            self._head += data[:wanted]
            breach = self._refused(self._head, 0, now) if known < 2 <= len(self._head) else None
            if breach is not None:
                return 0, breach
            length = _header(self._head, 0, len(self._head))
            if length is None:
                return size, None
            position = length[0] - known
            self._skip = length[1]
            self._head.clear()
        while True:
            step = min(self._skip, size - position)
            position += step
            self._skip -= step
            if position >= size:
                return size, None
            if size - position >= 2:
                breach = self._refused(data, position, now)
                if breach is not None:
                    return position, breach
            length = _header(data, position, size)
            if length is None:
                self._head += data[position:]
                return size, None
            position += length[0]
            self._skip = length[1]

    def _refused(self, data: bytes | bytearray, at: int, now: float) -> Breach | None:
        """Count the frame whose two first bytes are at ``at``; return its breach."""
        if not data[at + 1] & 0x80:
            return Breach(PROTOCOL_ERROR, "a client's frames need a mask")
        control = bool(data[at] & 0x08)
        if (self._quota.control if control else self._quota.frames).take(now):
            return None
        rate, kind = (self._limits.control, "control frames") if control else (self._limits.frames, "frames")
        return Breach(POLICY_VIOLATION, f"more than {rate:g} {kind} a second")


_MAX_HEADER = 14  # bytes: 2, 8 of length, 4 of mask


def _header(data: bytes | bytearray, at: int, end: int) -> tuple[int, int] | None:
    """Return the bytes of the header at ``at`` and of its payload; None where it is incomplete at ``end``."""
    if end - at < 2:
        return None
    short = data[at + 1] & 0x7F
    extended = 8 if short == 127 else 2 if short == 126 else 0
    size = 2 + extended + (4 if data[at + 1] & 0x80 else 0)
    if end - at < size:
        return None
    return size, int.from_bytes(data[at + 2 : at + 2 + extended], "big") if extended else short
