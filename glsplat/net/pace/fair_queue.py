"""Whose picture is drawn next: equal renderer time for every address, then for every client of an address.

Start-time fair queueing over two levels: the one who had the least time goes next, by a virtual clock that never runs
back, so that who was idle or is new has no credit for the past. All newcomers together have one share until their first
picture is drawn, else a stream of them would starve who is there. No I/O: times are seconds of any clock.

A picture cannot be put aside for another, so fair shares alone would leave a client of short pictures one of them
between two long ones. Long pictures therefore rest after each other while somebody waits who draws short ones.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

__all__ = ["FairQueue"]

K = TypeVar("K", bound=Hashable)

_LONG_RATIO = 4.0  # a picture that takes so many times the shortest of the others is long
_LENGTH_DECAY = 0.8  # a client's longest picture counts this much with each shorter one after it
_ACTIVE_S = 1.0  # seconds after its last request until a client of short pictures is not waited for
_STALL_S = 0.25  # seconds: after a picture of that length long ones rest as long as it took, and in proportion ...
_MAX_REST_RATIO = 5.0  # ... up to so many times as long: then long pictures have a sixth of the time
_MIN_CHARGE_S = 1e-4  # seconds a picture is charged at least


@dataclass(slots=True)
class _Client:
    spent: float  # virtual seconds, of the address's clock
    length: float | None = None  # seconds its pictures take; None: not known yet, so perhaps long
    asked: float = float("-inf")  # when it last had a picture to draw


@dataclass(slots=True)
class _Address(Generic[K]):
    spent: float  # virtual seconds
    clock: float = 0.0  # of its clients
    joining: float = 0.0  # where on it new clients begin
    fresh: bool = True  # nothing drawn for it yet
    clients: dict[K, _Client] = field(default_factory=dict)


class FairQueue(Generic[K]):
    """The clients that take part, by address. Ask ``next``, draw, then ``charge``."""

    def __init__(self) -> None:
        self._addresses: dict[str, _Address[K]] = {}
        self._clock = 0.0
        self._joining = 0.0  # where on it new addresses begin
        self._rest_until = float("-inf")
        self._rest_after = 0.0  # seconds the picture took that the others rest after, if it was a long one
        self._last = 0.0  # seconds the last picture took

    def __contains__(self, client: tuple[str, K]) -> bool:
        address = self._addresses.get(client[0])
        return address is not None and client[1] in address.clients

    def add(self, address: str, key: K, length: float | None = None) -> None:
        """A client takes part from now on, whose pictures take ``length`` seconds; None: that is not known."""
        mine = self._addresses.setdefault(address, _Address(max(self._clock, self._joining)))
        mine.clients[key] = _Client(max(mine.clock, mine.joining), length)

    def remove(self, address: str, key: K) -> None:
        """A client left. What its address owes is remembered until the others have caught up."""
        mine = self._addresses.get(address)
        if mine is not None:
            mine.clients.pop(key, None)
        for name in [n for n, a in self._addresses.items() if not a.clients and a.spent <= self._clock]:
            del self._addresses[name]

    def next(self, ready: Callable[[K], bool], now: float) -> K | None:
        """The client whose turn it is of those that are ``ready``. None: nobody is, or all of them ``rest``."""
        waiting: list[tuple[float, _Address[K], list[tuple[float, K]]]] = []
        for address in self._addresses.values():
            keys = [(max(c.spent, address.clock), key) for key, c in address.clients.items() if ready(key)]
            if keys:
                waiting.append((max(address.spent, self._clock), address, keys))
        for _, address, keys in waiting:
            for _, key in keys:
                address.clients[key].asked = now
        longest = self._longest_short(now) if now < self._rest_until else float("inf")
        resting = self._rest_after > longest
        waiting.sort(key=lambda entry: (entry[0], not entry[1].fresh))
        for spent, address, keys in waiting:
            keys.sort(key=lambda entry: entry[0])
            for mine, key in keys:
                client = address.clients[key]
                if resting and (client.length is None or client.length > longest):
                    continue
                # the clocks follow the one who had least, also where it rests
                self._clock, address.clock = max(self._clock, waiting[0][0]), max(address.clock, keys[0][0])
                address.spent, client.spent = spent, mine
                return key
        return None

    def charge(self, address: str, key: K, seconds: float, now: float, own: float | None = None) -> None:
        """The picture of that client took so long, up to ``now``; ``own`` seconds count for it within its address.

        The client may have left meanwhile.
        """
        mine = self._addresses.setdefault(address, _Address(self._clock))
        seconds = max(seconds, _MIN_CHARGE_S)
        if mine.fresh:
            self._joining = max(self._joining, self._clock) + seconds
            mine.fresh = False
        mine.spent += seconds
        self._last = seconds
        client = mine.clients.get(key)
        if client is None or client.length is None:
            mine.joining = max(mine.joining, mine.clock) + seconds
        if client is not None:
            client.spent += seconds if own is None else max(own, _MIN_CHARGE_S)
            client.length = max(seconds, _LENGTH_DECAY * (client.length or 0.0))
        until = now + seconds * min(_MAX_REST_RATIO, seconds / _STALL_S)
        if until > self._rest_until:
            self._rest_until, self._rest_after = until, seconds

    def rest(self, now: float) -> float:
        """Seconds after which to ask ``next`` again although nothing happened; 0: none."""
        return max(0.0, self._rest_until - now)

    def _longest_short(self, now: float) -> float:
        """Seconds above which a picture is long: by the shortest of those who asked a moment ago."""
        since = now - _ACTIVE_S - self._last  # nobody was asked during the last picture
        lengths = [
            client.length
            for address in self._addresses.values()
            for client in address.clients.values()
            if client.length is not None and client.asked >= since
        ]
        return _LONG_RATIO * min(lengths, default=float("inf"))
