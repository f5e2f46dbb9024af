"""Client addresses: their number of clients, spent quotas, hold-offs and failed pictures. No I/O."""

from __future__ import annotations

from collections import OrderedDict

from glsplat.net.guard.limits import Bucket, ClientQuota, Limits, Strikes


class _Address:
    """One address. Its quotas outlive its connections, so that reconnecting brings no fresh budget."""

    __slots__ = ("breaches", "clients", "guesses", "quotas", "uploads", "visits")

    def __init__(self, limits: Limits, now: float) -> None:
        most, forget = limits.hold_off_most, limits.forget
        self.clients = 0
        self.quotas: list[ClientQuota] = []  # of clients that left
        self.visits = Bucket.full(limits.visits, limits.visits_burst, now)
        self.uploads = Bucket.full(limits.uploads, limits.uploads_burst, now)
        self.breaches = Strikes(0, limits.hold_off, most, forget)
        self.guesses = Strikes(limits.guesses, 1.0, most, forget)


class Addresses:
    """A table of bounded size, by ``address_key``. Addresses with clients are never evicted.

    ``per_address``: limit of an address's clients. Each client has a quota of its own, so that one cannot use up those
    of its neighbours at the same address.
    """

    def __init__(self, limits: Limits, per_address: int) -> None:
        self.limits = limits
        self.per_address = per_address
        self._table: OrderedDict[str, _Address] = OrderedDict()  # least recently used first

    def __len__(self) -> int:
        return len(self._table)

    def visit(self, key: str, now: float, part: float = 1.0) -> bool:
        """Count a connection or an HTTP request, or ``part`` of one; return False where there are too many."""
        return self._at(key, now).visits.take(now, part)

    def upload(self, key: str, now: float) -> float:
        """Count a request to make an avatar; return the seconds to wait where there were too many, else 0."""
        uploads = self._at(key, now).uploads
        return 0.0 if uploads.take(now) else (1 - uploads.level) / uploads.rate

    def unfinished_upload(self, key: str, now: float, seconds: float) -> None:
        """Count the seconds that an incomplete upload occupied the upload slot."""
        self._at(key, now).uploads.charge(now, seconds * self.limits.uploads_unfinished)

    def enter(self, key: str, now: float) -> ClientQuota | None:
        """Return a quota for a new client, the fullest free one; None where the address has too many clients."""
        address = self._at(key, now)
        if address.clients >= self.per_address:
            return None
        address.clients += 1
        if len(address.quotas) + address.clients <= self.per_address:
            return ClientQuota(self.limits, now)
        address.quotas.sort(key=lambda quota: quota.fullness(now))
        return address.quotas.pop()

    def leave(self, key: str, quota: ClientQuota, now: float) -> None:
        """Take back the quota of a client that left."""
        address = self._at(key, now)
        address.clients -= 1
        address.quotas = [p for p in (*address.quotas, quota) if p.fullness(now) < 1]

    def breach(self, key: str, now: float) -> None:
        """Hold off an address after one of its clients broke a limit."""
        self._at(key, now).breaches.strike(now)

    def held_off(self, key: str, now: float) -> float:
        """Return the seconds for which this address is held off."""
        address = self._table.get(key)
        return 0.0 if address is None else address.breaches.wait(now)

    def guess(self, key: str, now: float) -> None:
        """Count a wrong token of this address."""
        self._at(key, now).guesses.strike(now)

    def guess_wait(self, key: str, now: float) -> float:
        """Return the seconds for which every token from this address is refused."""
        address = self._table.get(key)
        return 0.0 if address is None else address.guesses.wait(now)

    def count_held_off(self, now: float) -> int:
        """Return the number of addresses that are held off."""
        return sum(a.breaches.wait(now) > 0 or a.guesses.wait(now) > 0 for a in self._table.values())

    def _at(self, key: str, now: float) -> _Address:
        address = self._table.get(key)
        if address is None:
            if len(self._table) >= self.limits.addresses:
                self._forget(now)
            address = self._table[key] = _Address(self.limits, now)
        self._table.move_to_end(key)
        return address

    def _forget(self, now: float) -> None:
        """Evict an address without strikes, else the least recently used one; never one with clients."""
        oldest = None
        for key, address in self._table.items():
            if address.clients:
                continue
            oldest = oldest or key
            if address.breaches.forgotten(now) and address.guesses.forgotten(now):
                oldest = key
                break
        if oldest is not None:
            del self._table[oldest]


_FORGET_S = 600.0
_MAX_ADDRESSES = 4096
_SUSPECT_S, _MAX_SUSPECT_S = 10.0, 300.0  # for which others are suspected, after the first fault and at most
_SLOW_SHARE = 1 / 4  # of the others, after a picture that took too long


class FaultTracker:
    """Count pictures that took too long or crashed the renderer: the first is a warning, the next ends the client.

    They are counted by address, as a client could come back on a new connection.

    Faults of pictures that show other people of a room are not counted. Instead, pictures of that address show less of
    the others (``others``) for a while, which doubles with each fault.
    """

    def __init__(self) -> None:
        self._last: OrderedDict[str, float] = OrderedDict()  # time of an address's newest fault, oldest first
        self._others: OrderedDict[str, tuple[Strikes, float]] = OrderedDict()  # faults with others, share of others

    def again(self, address: str, now: float) -> bool:
        """Count a fault of this address; return whether it had one lately."""
        before = self._last.pop(address, None)
        self._last[address] = now
        if len(self._last) > _MAX_ADDRESSES:
            self._last.popitem(last=False)
        return before is not None and now - before < _FORGET_S

    def suspect_others(self, address: str, now: float, slow: bool) -> None:
        """Count a fault of a picture that shows others: it took too long (``slow``), or crashed the renderer."""
        strikes, _ = self._others.pop(address, (Strikes(0, _SUSPECT_S, _MAX_SUSPECT_S, _FORGET_S), 1.0))
        strikes.strike(now)
        self._others[address] = strikes, _SLOW_SHARE if slow and strikes.count == 1 else 0.0
        if len(self._others) > _MAX_ADDRESSES:
            self._others.popitem(last=False)

    def others(self, address: str, now: float) -> float:
        """Return the share of others in pictures of this address, as in RenderJob: 1 all, 0 nobody."""
        strikes, share = self._others.get(address, (None, 1.0))
        return 1.0 if strikes is None or not strikes.wait(now) else share

    def suspects(self, address: str, now: float) -> bool:
        """Return whether this address had a fault lately."""
        before = self._last.get(address)
        return before is not None and now - before < _FORGET_S
