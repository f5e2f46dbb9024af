"""FairQueue: equal renderer time for every address, and within it for every client. Times are seconds of any clock.

Start-time fair queueing on two levels: the client with the least time is next, by a virtual clock that never runs back,
so that idle or new clients have no credit for the past. All newcomers share one client's time until their first picture
is drawn, or a stream of them would starve the others.

A picture cannot be preempted: with fair shares alone, a client of short pictures would get one of them between two long
ones. So long pictures rest after each other while a client of short pictures waits.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)

_LONG_RATIO = 4.0  # of a long picture's time to the shortest client's
_LENGTH_DECAY = 0.8  # of a client's longest picture, with each shorter one after it
_ACTIVE_S = 1.0  # after its last request, a client of short pictures is not waited for
_STALL_S = 0.25  # after a picture of that length, long ones rest as long as it took, and in proportion ...
_MAX_REST_RATIO = 5.0  # ... up to this ratio, which leaves a sixth of the time to long pictures
_MIN_CHARGE_S = 1e-4  # of a picture


@dataclass(slots=True)
class _Client:
    spent: float  # virtual seconds, of the address's clock
    length: float | None = None  # seconds of its pictures; None: unknown yet, so perhaps long
    waited: float = float("-inf")  # when it last had a picture to draw


@dataclass(slots=True)
class _Address(Generic[K]):
    spent: float  # virtual seconds
    clock: float = 0.0  # of its clients
    joining: float = 0.0  # virtual seconds at which new clients start
    fresh: bool = True  # nothing was drawn for it yet
    clients: dict[K, _Client] = field(default_factory=dict)


class FairQueue(Generic[K]):
    """The clients by address. Call ``next``, draw, then ``charge``."""

    def __init__(self) -> None:
        self._addresses: dict[str, _Address[K]] = {}
        self._clock = 0.0
        self._joining = 0.0  # virtual seconds at which new addresses start
        self._rest_until = float("-inf")
        self._rest_after = 0.0  # seconds of the long picture after which others rest
        self._last = 0.0  # seconds of the last picture

    def __contains__(self, client: tuple[str, K]) -> bool:
        address = self._addresses.get(client[0])
        return address is not None and client[1] in address.clients

    def add(self, address: str, key: K, length: float | None = None) -> None:
        """Add a client whose pictures take ``length`` seconds; None: unknown."""
        mine = self._addresses.setdefault(address, _Address(max(self._clock, self._joining)))
        mine.clients[key] = _Client(max(mine.clock, mine.joining), length)

    def remove(self, address: str, key: K) -> None:
        """Remove a client. The time of its address is remembered until the others have caught up."""
        mine = self._addresses.get(address)
        if mine is not None:
            mine.clients.pop(key, None)
        for name in [n for n, a in self._addresses.items() if not a.clients and a.spent <= self._clock]:
            del self._addresses[name]

    def next(self, ready: Callable[[K], bool], now: float) -> K | None:
        """Return the ``ready`` client whose turn it is; None if none is ready, or all of them ``rest``."""
        waiting: list[tuple[float, _Address[K], list[tuple[float, K]]]] = []
        for address in self._addresses.values():
            keys = [(max(c.spent, address.clock), key) for key, c in address.clients.items() if ready(key)]
            if keys:
                waiting.append((max(address.spent, self._clock), address, keys))
        for _, address, keys in waiting:
            for _, key in keys:
                address.clients[key].waited = now
        longest = self._longest_short(now) if now < self._rest_until else float("inf")
        resting = self._rest_after > longest
        waiting.sort(key=lambda entry: (entry[0], not entry[1].fresh))
        for spent, address, keys in waiting:
            keys.sort(key=lambda entry: entry[0])
            for mine, key in keys:
                client = address.clients[key]
                if resting and (client.length is None or client.length > longest):
                    continue
                # the clocks follow the client with the least time, also while it rests
                self._clock, address.clock = max(self._clock, waiting[0][0]), max(address.clock, keys[0][0])
                address.spent, client.spent = spent, mine
                return key
        return None

    def charge(self, address: str, key: K, seconds: float, now: float, own: float | None = None) -> None:
        """Charge a picture of ``seconds`` that ended ``now``; ``own`` seconds replace them within its address.

        The client may have been removed meanwhile.
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
        """Return the seconds until resting clients may be ``next``; 0: none rests."""
        return max(0.0, self._rest_until - now)

    def _longest_short(self, now: float) -> float:
        """Return the seconds above which a picture is long, by the shortest pictures of active clients."""
        since = now - _ACTIVE_S - self._last  # no client is checked during a picture
        lengths = [
            client.length
            for address in self._addresses.values()
            for client in address.clients.values()
            if client.length is not None and client.waited >= since
        ]
        return _LONG_RATIO * min(lengths, default=float("inf"))
