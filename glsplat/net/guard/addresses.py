"""The addresses that connect: how many clients each has, what they spent, and which of them are held off. No I/O."""

from __future__ import annotations

from collections import OrderedDict

from glsplat.net.guard.limits import Bucket, ClientQuota, Limits, Strikes

__all__ = ["Addresses"]


class _Address:
    """One address. Its quotas outlive its connections, so that connecting again brings no fresh budget."""

    __slots__ = ("breaches", "clients", "guesses", "quotas", "uploads", "visits")

    def __init__(self, limits: Limits, now: float) -> None:
        most, forget = limits.hold_off_most, limits.forget
        self.clients = 0
        self.quotas: list[ClientQuota] = []  # those that no client holds
        self.visits = Bucket.full(limits.visits, limits.visits_burst, now)
        self.uploads = Bucket.full(limits.uploads, limits.uploads_burst, now)
        self.breaches = Strikes(0, limits.hold_off, most, forget)
        self.guesses = Strikes(limits.guesses, 1.0, most, forget)


class Addresses:
    """A table of bounded size, by ``address_key``. Addresses with clients are never left out of it.

    ``per_address`` clients an address at most. A client never spends from another's quota, so that what one does costs
    its neighbours at the same address nothing while they are connected.
    """

    def __init__(self, limits: Limits, per_address: int) -> None:
        self.limits = limits
        self.per_address = per_address
        self._table: OrderedDict[str, _Address] = OrderedDict()  # the one heard of longest ago first

    def __len__(self) -> int:
        return len(self._table)

    def visit(self, key: str, now: float, part: float = 1.0) -> bool:
        """Count a connection or an HTTP request, or as ``part`` of one; False: too many."""
        return self._at(key, now).visits.take(now, part)

    def upload(self, key: str, now: float) -> float:
        """Count a request to make an avatar; seconds to wait where there were too many, else 0."""
        uploads = self._at(key, now).uploads
        return 0.0 if uploads.take(now) else (1 - uploads.level) / uploads.rate

    def unfinished_upload(self, key: str, now: float, seconds: float) -> None:
        """Count the time for which pictures that never were complete kept others from sending theirs."""
        self._at(key, now).uploads.charge(now, seconds * self.limits.uploads_unfinished)

    def enter(self, key: str, now: float) -> ClientQuota | None:
        """A client's quota, the fullest that is free; None: the address has as many clients as it may."""
        address = self._at(key, now)
        if address.clients >= self.per_address:
            return None
        address.clients += 1
        if len(address.quotas) + address.clients <= self.per_address:
            return ClientQuota(self.limits, now)
        address.quotas.sort(key=lambda quota: quota.fullness(now))
        return address.quotas.pop()

    def leave(self, key: str, quota: ClientQuota, now: float) -> None:
        """The client that held ``quota`` is gone."""
        address = self._at(key, now)
        address.clients -= 1
        address.quotas = [p for p in (*address.quotas, quota) if p.fullness(now) < 1]

    def breach(self, key: str, now: float) -> None:
        """A client of this address broke a limit: new connections are refused for a while."""
        self._at(key, now).breaches.strike(now)

    def held_off(self, key: str, now: float) -> float:
        """Seconds during which nothing new is taken from this address."""
        address = self._table.get(key)
        return 0.0 if address is None else address.breaches.wait(now)

    def guess(self, key: str, now: float) -> None:
        """A wrong token came from this address."""
        self._at(key, now).guesses.strike(now)

    def no_guess(self, key: str, now: float) -> float:
        """Seconds during which no token from this address is looked at, the right one included."""
        address = self._table.get(key)
        return 0.0 if address is None else address.guesses.wait(now)

    def count_held_off(self, now: float) -> int:
        """How many addresses are held off."""
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
        """Make room: who has nothing held against it goes first, else who was heard of longest ago."""
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
