"""Client addresses: their number of clients, spent quotas and hold-offs. No I/O."""

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
