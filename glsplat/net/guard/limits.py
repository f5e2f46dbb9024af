"""Limits of one client, one address and all strangers together: the numbers, and the buckets that enforce them.

No clocks and no sockets: times are arguments, in seconds of any monotonic clock.
"""

from __future__ import annotations

import ipaddress
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

_BUDGET_S = 1.0  # of its rate that a budget holds
_SHORT_MESSAGE = 64  # characters; read at once: an acknowledgement, which costs next to nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a server. The defaults are twice the needs of a client at 120 Hz with full hands (9 kB a request).

    Bursts are the backlog of such a client after a network outage of 20 seconds.
    """

    frames: float = 1000.0  # text, binary and continuation frames a second of one client ...
    frames_burst: float = 5000.0  # ... and at once on top of that
    control: float = 20.0  # pings, pongs and closes a second; each ping costs a pong
    control_burst: float = 100.0
    bytes: float = 2.0 * 2**20  # a second
    bytes_burst: float = 24.0 * 2**20
    samples: float = 150.0  # of tracking, solved one by one a second of one client; above it the newest only
    samples_burst: float = 50.0
    work: float = 0.3  # seconds a second on reading all clients' JSON and solving their tracking, which share one
    # interpreter lock with everything else; once used up, addresses have equal parts, and clients within an address
    work_alone: float = 0.6  # the same while nothing is drawn
    per_address: int | None = None  # clients of one address; None: half of max_clients, all of them on loopback
    visits: float = 10.0  # connections and HTTP requests a second of one address
    visits_burst: float = 50.0
    file: float = 0.1  # of a visit, for a file of the page (/vr), which has a few dozen of them, or a study's message
    waiting: int = 64  # connections of all addresses that are not, or not yet, clients
    head: int = 64 * 1024  # bytes before a request is whole, or between one and the next
    body: int = 512 * 1024  # the same where clients send pictures: bytes received before a request is checked
    uploads: float = 0.05  # requests a second to make an avatar, of one address
    uploads_burst: float = 6.0
    uploads_unfinished: float = 0.25  # of such a request, for each second of an upload that ended incomplete
    guesses: int = 5  # wrong tokens of one address before the hold-off begins at 1 s
    hold_off: float = 10.0  # seconds an address is held off after one of its clients broke a limit
    hold_off_most: float = 300.0  # each further breach (or guess) doubles the hold-off up to this
    forget: float = 600.0  # seconds without a breach (or guess) until they are forgotten
    addresses: int = 4096  # remembered


@dataclass(slots=True)
class Bucket:
    """A token bucket: ``capacity`` at once, refilled by ``rate`` a second. It may be overdrawn by ``charge``."""

    capacity: float
    rate: float
    level: float
    time: float

    @classmethod
    def full(cls, rate: float, burst: float, now: float) -> Bucket:
        """Return a full bucket: ``burst`` at once, then ``rate`` a second."""
        return cls(burst, rate, burst, now)

    def left(self, now: float) -> float:
        """Return the level at ``now``."""
        self.level = min(self.capacity, self.level + max(0.0, now - self.time) * self.rate)
        self.time = max(self.time, now)
        return self.level

    def take(self, now: float, amount: float = 1.0) -> bool:
        """Take ``amount`` and return True if it is there."""
        if self.left(now) < amount:
            return False
        self.level -= amount
        return True

    def charge(self, now: float, amount: float) -> None:
        """Take ``amount`` whether it is there or not."""
        self.left(now)
        self.level -= amount


class ClientQuota:
    """Buckets of one client. They belong to its address: a client that reconnects finds them as it left them."""

    __slots__ = ("bytes", "control", "frames", "samples")

    def __init__(self, limits: Limits, now: float) -> None:
        self.frames: Bucket = Bucket.full(limits.frames, limits.frames_burst, now)
        self.control: Bucket = Bucket.full(limits.control, limits.control_burst, now)
        self.bytes: Bucket = Bucket.full(limits.bytes, limits.bytes_burst, now)
        self.samples: Bucket = Bucket.full(limits.samples, limits.samples_burst, now)

    def fullness(self, now: float) -> float:
        """Return the level of the emptiest bucket: 1 untouched, 0 or below used up."""
        return min(b.left(now) / b.capacity for b in (self.frames, self.control, self.bytes, self.samples))


class CpuBudget:
    """Working time, ``rate`` seconds a second, shared by all clients until it is used up.

    Then addresses have equal parts, and clients within an address. While nothing is drawn (``draws`` is False) there
    are ``alone`` seconds.
    """

    def __init__(
        self, rate: float, now: float, alone: float | None = None, draws: Callable[[], bool] = lambda: True
    ) -> None:
        self.rate, self.draws = rate, draws
        self.all: Bucket = Bucket.full(rate, rate * _BUDGET_S, now)
        most = max(rate, alone or rate)
        self.alone: Bucket = Bucket.full(most, most * _BUDGET_S, now)
        self._shares: dict[str, list[CpuShare]] = {}  # by address

    def open(self, now: float, address: str = "") -> CpuShare:
        """Return a new client's share."""
        share = CpuShare(self, Bucket.full(self.rate, self.rate * _BUDGET_S, now), address)
        self._shares.setdefault(address, []).append(share)
        self._divide()
        return share

    def close(self, share: CpuShare) -> None:
        """Remove the share of a client that left."""
        mine = self._shares[share.address]
        mine.remove(share)
        if not mine:
            del self._shares[share.address]
        self._divide()

    def _divide(self) -> None:
        for shares in self._shares.values():
            for share in shares:
                share.part.rate = self.rate / len(self._shares) / len(shares)
                share.part.capacity = share.part.rate * _BUDGET_S


@dataclass(eq=False, slots=True)
class CpuShare:
    """One client's part of a budget. Any thread may call ``spend``, one thread calls the others."""

    budget: CpuBudget
    part: Bucket
    address: str = ""
    _spent: deque[tuple[float, float]] = field(default_factory=deque)

    def spend(self, own: float, all_in_all: float | None = None) -> None:
        """Record the seconds of a client's work, and those for which others had to wait, if that is more."""
        self._spent.append((own, own if all_in_all is None else all_in_all))

    def left(self, now: float) -> bool:
        """Return whether the client may spend more."""
        while self._spent:
            own, all_in_all = self._spent.popleft()
            self.part.charge(now, own)
            self.budget.all.charge(now, all_in_all)
            self.budget.alone.charge(now, all_in_all)
        within = self.part.left(now) > 0
        if self.budget.all.left(now) > 0 or within:
            return True
        return self.budget.alone.left(now) > 0 and not self.budget.draws()

    def wait(self, now: float) -> float:
        """Return the seconds until the client's own part is refilled."""
        return max(0.0, -self.part.left(now)) / self.part.rate


class MessageThrottle:
    """Read a client's newest message only while its share of the time lasts: one message at most waits."""

    def __init__(self, share: CpuShare) -> None:
        self.share = share
        self.left_out = 0  # messages dropped unread for newer ones
        self._waiting: str | None = None

    def offer(self, text: str, now: float) -> str | None:
        """Return a received message if it may be read now; None: it waits."""
        if len(text) <= _SHORT_MESSAGE:
            return text
        self.left_out += self._waiting is not None
        self._waiting = None
        if self.share.left(now):
            return text
        self._waiting = text
        return None

    def wait(self, now: float) -> float:
        """Return the seconds until ``take`` has something to read; infinity: nothing waits."""
        return float("inf") if self._waiting is None else self.share.wait(now)

    def take(self) -> str | None:
        """Return the waiting message, if any."""
        text, self._waiting = self._waiting, None
        return text


@dataclass(slots=True)
class Strikes:
    """Breaches of one kind by one address, and their hold-off: ``first`` seconds, doubled by each further one."""

    free: int  # breaches without a hold-off
    first: float  # seconds
    most: float  # seconds
    forget: float  # seconds without a breach until all are forgotten
    count: int = 0
    until: float = float("-inf")
    last: float = float("-inf")

    def strike(self, now: float) -> None:
        """Count a breach."""
        self.count = 1 if now - max(self.last, self.until) > self.forget else self.count + 1
        self.last = now
        if self.count > self.free:
            self.until = now + min(self.most, self.first * 2.0 ** min(self.count - self.free - 1, 30))

    def wait(self, now: float) -> float:
        """Return the seconds until the address may try again; 0: now."""
        return max(0.0, self.until - now)

    def forgotten(self, now: float) -> bool:
        """Return whether no breach counts any more."""
        return self.count == 0 or now - max(self.last, self.until) > self.forget


def address_key(host: str) -> str:
    """Return the key of a client's address: an IPv4 address, or the /64 network of an IPv6 subscriber."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host[:64]
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return str(address.ipv4_mapped)
        return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)
